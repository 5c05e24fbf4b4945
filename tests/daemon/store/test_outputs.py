"""One rule for all commands: the place of results is checked before the work, and nothing is overwritten unasked."""

import os

import pytest

from daemon.base.errors import UserError
from daemon.store.outputs import check_outputs


def test_an_existing_output_file_is_refused_without_force(tmp_path):
    there = tmp_path / "energy.csv"
    there.write_text("mine")
    check_outputs([there, tmp_path / "energy.txt"], "--out", force=True)
    with pytest.raises(UserError) as refused:
        check_outputs([tmp_path / "energy.txt", there], "--out", force=False)
    assert str(refused.value) == f"{there} is there already: --force overwrites it, or name another --out"


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("file/a.csv", "--plot: {folder}/file cannot be a folder: {folder}/file is a file"),
        ("file/b/c/a.csv", "--plot: {folder}/file/b/c cannot be a folder: {folder}/file is a file"),
        ("folder", "--plot: {folder}/folder is a folder: name a file in it"),
        ("null", "--plot: {folder}/null is no ordinary file, but a device or a pipe: name another"),
    ],
)
@pytest.mark.parametrize("force", [True, False])
def test_an_output_path_that_cannot_take_a_file_is_refused_before_the_work(tmp_path, path, told, force):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    (tmp_path / "null").symlink_to(os.devnull)
    with pytest.raises(UserError) as refused:
        check_outputs([tmp_path / path], "--plot", force=force)
    assert str(refused.value) == told.format(folder=tmp_path)


def test_checking_the_output_paths_creates_nothing(tmp_path):
    check_outputs([tmp_path / "new" / "folder" / "a.csv"], "--out", force=False)
    assert not list(tmp_path.iterdir())
