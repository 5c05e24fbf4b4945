"""The store's file to whoever may not read it."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.store.schema import FILE_NAME, open_for_reading
from daemon.store.store import Origin, Store

ORIGIN = Origin(0.0, "both", "0.1.0", True, "SIRTA", 48.7, 2.2, 156.0)


@pytest.mark.parametrize("closed", [".", FILE_NAME])
def test_a_store_of_another_user_is_one_sentence_with_the_remedy(closed):
    user = os.geteuid()
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        path = Path(folder) / "records" / FILE_NAME
        Store(path.parent, 60.0, 400, ORIGIN, SystemClock(), lambda event: None).close()
        (path.parent / closed).chmod(0)
        try:
            if user == 0:
                os.seteuid(65534)
            with pytest.raises(UserError, match=r"may not be read by this user.*sudo -u heliocube"):
                open_for_reading(path)
        finally:
            os.seteuid(user)
            path.parent.chmod(0o755)
