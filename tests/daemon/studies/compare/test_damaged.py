"""Files that were cut off or damaged are refused in one sentence."""

import gzip
import json

import pytest

from daemon.base.errors import UserError
from daemon.studies.compare.fit import fit, read, write
from daemon.studies.compare.measurements import Measurement
from daemon.studies.compare.pairs import frame_of, pair, read_tables

NAMES = ("T-Cube", "T-Chrono")


def test_a_packed_table_of_powers_that_was_cut_off_is_refused(tmp_path):
    rows = "".join(f"2022-10-12T10:00:{n % 60:02d}Z,T-Cube,{n * n % 97}\n" for n in range(9999))
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(gzip.compress(f"time,tracker,pmpp_w\n{rows}".encode())[:2000])
    with pytest.raises(UserError, match=r"cut\.csv\.gz cannot be read: it is cut off or damaged"):
        read_tables([cut])


@pytest.mark.parametrize("wrong", [{"mbe_w": None}, {"count": 1e999}, {"rmae_pct": float("nan")}])
def test_a_bias_file_with_a_missing_or_invalid_number_is_refused_as_damaged(tmp_path, wrong):
    flat = [Measurement(5.0 * n, name, 50.0 + n, *[0.0] * 6) for n in range(200) for name in NAMES]
    path = tmp_path / "bias.json"
    found = fit(pair(frame_of(flat), NAMES))
    write(found, path)
    assert read(path) == found
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"before": content["before"] | wrong}))
    with pytest.raises(UserError, match=r"bias\.json is damaged "):
        read(path)
