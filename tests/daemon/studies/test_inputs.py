"""Files that people give to the studies and commands."""

import pytest

from daemon.base.errors import UserError
from daemon.studies.calibrate.readings import read_reference
from daemon.studies.compare.pairs import read_tables
from daemon.studies.inputs import check_weather_file


@pytest.mark.parametrize("read", [read_reference, check_weather_file, lambda path: read_tables([path])])
@pytest.mark.parametrize("ending", ["csv.xz", "csv.ZIP", "tar.gz", "csv.zst"])
def test_a_table_that_is_packed_otherwise_than_with_gzip_is_refused_with_what_to_do(tmp_path, read, ending):
    path = tmp_path / f"table.{ending}"
    path.write_bytes(b"damaged")
    with pytest.raises(UserError) as refused:
        read(path)
    remedy = "is packed in a way that cannot be read: unpack it, or pack the table alone with gzip (.gz)"
    assert str(refused.value) == f"{path} {remedy}"
