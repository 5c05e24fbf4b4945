"""Who is told: the file that names them, and a try of each way and of the heartbeat."""

import asyncio
import threading

import pytest
from apprise.decorators import notify

from daemon.base.errors import UserError
from daemon.config.links import NotifySettings
from daemon.notify import recipients
from daemon.notify.courier import send_test_notice as try_out
from daemon.notify.notices import Notice
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
def test_an_unusable_people_file_is_refused_without_showing_its_secrets(tmp_path, content, mode, sentence):
    people = tmp_path / "people"
    if content is not None:
        people.write_text(content)
        people.chmod(mode)
    with pytest.raises(UserError) as refused:
        recipients_of(people)
    assert sentence in str(refused.value)
    assert "secret" not in str(refused.value)


def test_the_notification_test_reports_the_outcome_for_each_recipient_and_the_heartbeat(lab, tmp_path):
    people = tmp_path / "people"
    people.write_text(f"ntfy://{lab.address}/roof\njson://user:secret@127.0.0.1:1/\n")
    people.chmod(0o640)
    lines = []
    settings = NotifySettings(heartbeat=f"http://{lab.address}/beat")
    assert asyncio.run(try_out(settings, recipients_of(people), lines.append)) is False
    assert [line.rpartition(": ")[2] for line in lines] == ["taken", "not taken; see the lines above", "taken"]
    assert "secret" not in "".join(lines)
    assert "a test" in str(lab.told[0])


@pytest.mark.parametrize("kind", ["ntfy", "json"])
def test_a_server_that_redirects_has_not_taken_the_notice_even_if_the_redirect_target_answers(lab, tmp_path, kind):
    lab.moved_to = "/sign-in"
    people = tmp_path / "people"
    people.write_text(f"{kind}://{lab.address}/roof\n")
    people.chmod(0o640)
    (recipient,) = recipients_of(people)
    assert asyncio.run(recipient.send(Notice("a title", "a body", "warning"))) is False


def test_the_notification_test_ends_with_4_unless_it_reaches_every_recipient(lab, tmp_path):
    config, people = tmp_path / "notify.toml", tmp_path / "people"
    config.write_text("[notify]\npeople_file = 'people'\n")
    people.touch(0o600)
    for port, code in ((lab.address.rpartition(":")[2], 0), ("1", 4)):
        people.write_text(f"json://127.0.0.1:{port}/\n")
        done = forks.run("notify", "--config", config, "--test")
        assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr


class Hung:
    """Takes a message only when it is set free, or much later; counts the messages that it was given and has taken."""

    def __init__(self):
        self.calls, self.taken, self.free = 0, 0, threading.Event()

    def take(self):
        self.calls += 1
        self.free.wait(20.0)
        self.taken += 1
        return True


# apprise keeps a registered way for good: so the way stays, and each test puts a new object here.
HANGING = [Hung()]


@notify(on="hang")
def hang(*_, **__):
    return HANGING[0].take()


@pytest.fixture
def hung():
    HANGING[0] = Hung()
    yield HANGING[0]
    HANGING[0].free.set()


def named(folder, *addresses):
    people = folder / "people"
    people.write_text("\n".join(addresses))
    people.chmod(0o600)
    return recipients_of(people)


def test_recipients_that_hang_delay_neither_other_recipients_nor_the_end_of_the_event_loop(hung, lab, tmp_path):
    *stuck, good = named(tmp_path, *(f"hang://{n}" for n in range(10)), f"json://{lab.address}/json")

    async def scenario():
        telling = [asyncio.create_task(each.send(Notice("a title", "a text", "warning"))) for each in stuck]
        await asyncio.sleep(0)
        assert await good.send(Notice("a title", "a text", "warning"))
        for each in telling:
            each.cancel()

    asyncio.run(scenario())
    assert (hung.calls, hung.taken) == (10, 0)


def test_a_recipient_that_hangs_is_logged_and_gets_no_other_notice_before_it_has_returned(
    hung, tmp_path, monkeypatch, caplog
):
    monkeypatch.setattr(recipients, "_TAKEN_WITHIN_S", 0.05)
    (stuck,) = named(tmp_path, "hang://roof")
    notice = Notice("a title", "a text", "warning")

    async def scenario():
        assert not await stuck.send(notice)
        assert not await stuck.send(notice)
        assert hung.calls == 1
        hung.free.set()
        while hung.calls == 1:
            await stuck.send(notice)
            await asyncio.sleep(0.01)

    asyncio.run(scenario())
    assert "has not ended within 0.05 s" in caplog.text
