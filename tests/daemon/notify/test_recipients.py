"""Who is told: the file that names them, and a try of each way and of the heartbeat."""

import asyncio

import pytest

from daemon.base.errors import UserError
from daemon.config.links import NotifySettings
from daemon.notify.courier import test as try_out
from daemon.notify.recipients import recipients_of
from tests.daemon.notify.test_courier import lab
from tests.support import forks

__all__ = ["lab"]

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("content", "mode", "sentence"),
    [
        (None, 0o600, "does not exist: write one apprise address on each line, such as ntfy://ntfy.lab/roof, and run"),
        ("", 0o600, "names nobody"),
        ("tea://secret\n", 0o600, "line 1: no address that apprise knows"),
        ("# x\njson://\n", 0o600, "line 2: no address that apprise knows"),
        ("json://a/\n", 0o644, "is open to others than its owner and its group's readers: run chmod 640"),
    ],
)
def test_a_file_that_names_nobody_is_refused_without_what_is_secret(tmp_path, content, mode, sentence):
    people = tmp_path / "people"
    if content is not None:
        people.write_text(content)
        people.chmod(mode)
    with pytest.raises(UserError) as refused:
        recipients_of(people)
    assert sentence in str(refused.value)
    assert "secret" not in str(refused.value)


def test_a_try_says_of_each_way_and_of_the_heartbeat_what_came_of_it(lab, tmp_path):
    people = tmp_path / "people"
    people.write_text(f"ntfy://{lab.address}/roof\njson://user:secret@127.0.0.1:1/\n")
    people.chmod(0o640)
    lines = []
    settings = NotifySettings(heartbeat=f"http://{lab.address}/beat")
    assert asyncio.run(try_out(settings, recipients_of(people), lines.append)) is False
    assert [line.rpartition(": ")[2] for line in lines] == ["taken", "not taken; see the lines above", "taken"]
    assert "secret" not in "".join(lines)
    assert "a test" in str(lab.told[0])


def test_a_try_that_does_not_reach_everybody_ends_with_4(lab, tmp_path):
    config, people = tmp_path / "notify.toml", tmp_path / "people"
    config.write_text("[notify]\npeople_file = 'people'\n")
    people.touch(0o600)
    for port, code in ((lab.address.rpartition(":")[2], 0), ("1", 4)):
        people.write_text(f"json://127.0.0.1:{port}/\n")
        done = forks.run("notify", "--config", config, "--test")
        assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr
