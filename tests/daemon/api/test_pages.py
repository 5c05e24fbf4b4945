"""What readers get is made once, whoever and however many ask for it."""

import asyncio
import json

from daemon.api import pages
from daemon.api.pages import Feed, KeptPage, ScanLog
from daemon.base.records import Event, FaceReading, Quality, Scan


def scan(sequence):
    faces = [FaceReading(500.0 + sequence, Quality.OK, 5.0 * sequence, 5.0 * sequence) for _ in range(4)]
    return Scan(
        time_utc_s=1e9 + 5.0 * sequence,
        time_monotonic_s=5.0 * sequence,
        source="cube",
        session="s",
        sequence=sequence,
        simulated=True,
        east=faces[0],
        south=faces[1],
        west=faces[2],
        zenith=faces[3],
    )


def test_a_page_is_made_once_in_a_tenth_of_a_second_and_anew_when_something_has_changed():
    now_s, made = [100.0], []

    def make():
        made.append(now_s[0])
        return str(len(made)).encode()

    page = KeptPage(make, lambda: now_s[0], speed=60.0)
    assert {page.get() for _ in range(40)} == {b"1"}
    now_s[0] += 5.9
    assert page.get() == b"1"
    now_s[0] += 0.1
    assert page.get() == b"2"
    page.forget()
    assert page.get() == b"3"


def test_scans_are_written_when_they_come_and_not_when_they_are_asked_for(monkeypatch):
    log = ScanLog()
    for sequence in range(1200):
        log.note(scan(sequence))
    log.note(Event(1.0, 1.0, "test", "no scan"))
    monkeypatch.setattr(pages, "record_json", None)
    found, since_utc_s, lengths = [], -1.0, []
    while True:
        page = json.loads(log.page(since_utc_s))
        found += [item["sequence"] for item in page["scans"]]
        lengths.append(len(page["scans"]))
        if not page["more"]:
            break
        since_utc_s = 1e9 + 5.0 * found[-1]
    assert (found, lengths) == (list(range(1200)), [500, 500, 200])
    assert json.loads(log.page(1e10)) == {"scans": [], "more": False}


def test_an_event_is_written_once_for_all_listeners_and_for_none_not_at_all(monkeypatch):
    written, write = [], pages.record_json
    monkeypatch.setattr(pages, "record_json", lambda record: written.append(record) or write(record))

    async def scenario():
        feed = Feed()
        feed.note(Event(1.0, 1.0, "test", "nobody listens"))
        with feed.listening() as one, feed.listening() as other:
            feed.note(Event(2.0, 2.0, "test", "hello"))
            assert one.get_nowait() == other.get_nowait()
        assert [record.text for record in written] == ["hello"]

    asyncio.run(scenario())


def test_a_listener_that_does_not_read_costs_a_bounded_queue_and_nobody_else_anything():
    async def scenario():
        feed = Feed()
        with feed.listening() as queue:
            for n in range(5000):
                feed.note(Event(float(n), float(n), "test", str(n)))
            assert queue.qsize() == 500
            assert b'"text":"4500"' in queue.get_nowait()
        assert feed.listeners == 0

    asyncio.run(scenario())
