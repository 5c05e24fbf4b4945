"""Which laws can be named."""

import pytest

from daemon.base.errors import UserError
from daemon.base.plugins import LAWS
from daemon.studies.energy.names import check_names
from tests.support.packages import install


def test_an_unknown_law_is_refused_with_the_known_ones_even_beside_a_broken_third_party_package(tmp_path, monkeypatch):
    install(monkeypatch, tmp_path, f"[{LAWS}]\nbent = bent\n", {"bent": "raise OSError('no licence')"}, name="acme")
    with pytest.raises(UserError, match=r"there is no law 'best'; choose from .*bent.*optimal:THRIFT"):
        check_names(["isotropic"], ["best"])
