"""Where a service keeps records and state if no folder is named: beside its file, apart from any other service's."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from daemon.base.errors import UserError
from daemon.store.records_folder import default_records_folder, lock_folder


@pytest.mark.parametrize(
    ("file", "environment", "place"),
    [
        ("rig/heliocube.toml", {}, "rig/records"),
        ("rig/east.toml", {}, "rig/east-records"),
        ("/etc/heliocube/tracker.toml", {"STATE_DIRECTORY": "/var/lib/heliocube"}, "/var/lib/heliocube/tracker"),
        ("/etc/heliocube/cube.toml", {"STATE_DIRECTORY": "/var/lib/heliocube:/b"}, "/var/lib/heliocube/cube"),
        ("rig/east.toml", {"STATE_DIRECTORY": "", "XDG_STATE_HOME": "/home/ana"}, "rig/east-records"),
    ],
)
def test_each_configuration_file_has_a_default_folder_of_its_own_for_records(file, environment, place):
    assert default_records_folder(Path(file), environment) == Path(place)


def test_two_services_of_one_role_do_not_share_a_folder(tmp_path):
    with lock_folder(tmp_path / "records", ("cube",)):
        with (
            pytest.raises(UserError, match="another service that runs keeps records and state of the role cube in "),
            lock_folder(tmp_path / "records", ("tracker", "cube")),
        ):
            pytest.fail("two cubes keep their records in one folder")
        with lock_folder(tmp_path / "records", ("tracker",)), lock_folder(tmp_path / "other", ("cube",)):
            pass
    with lock_folder(tmp_path / "records", ("tracker", "cube")):
        pass


def test_a_folder_that_cannot_take_a_file_may_be_claimed_more_than_once(tmp_path):
    (tmp_path / "file").write_text("")
    with ExitStack() as stack:
        for _ in range(2):
            stack.enter_context(lock_folder(tmp_path / "file", ("tracker",)))
            stack.enter_context(lock_folder(None, ("tracker",)))
    assert (tmp_path / "file").read_text() == ""
