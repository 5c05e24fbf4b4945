"""What readers get is made once, however many ask for it."""

import asyncio
import json
import math
import threading
import time
from dataclasses import replace

from daemon.api import pages
from daemon.api.history import parse_query_time
from daemon.api.pages import CachedPage, Feed, ScanLog
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


def test_a_page_is_made_at_most_once_per_tenth_of_a_second_and_again_after_a_change():
    now_s, taken = [100.0], []

    def take():
        taken.append(threading.current_thread())
        return len(taken)

    def make(number):
        assert threading.current_thread() is not taken[0]
        return str(number).encode()

    async def scenario():
        page = CachedPage(take, make, lambda: now_s[0], speed=60.0)
        assert set(await asyncio.gather(*(page.get() for _ in range(40)))) == {b"1"}
        now_s[0] += 5.9
        assert await page.get() == b"1"
        now_s[0] += 0.1
        assert await page.get() == b"2"
        page.forget()
        assert await page.get() == b"3"

    asyncio.run(scenario())


def test_a_slow_page_is_made_once_for_all_waiting_readers_even_if_one_of_them_leaves():
    now_s, made, may_end = [100.0], [], threading.Event()

    def make(number):
        made.append(number)
        may_end.wait(30)
        return b"page"

    async def scenario():
        page = CachedPage(lambda: 1, make, lambda: now_s[0], speed=1.0)
        first, second = asyncio.ensure_future(page.get()), asyncio.ensure_future(page.get())
        await asyncio.sleep(0)
        now_s[0] += 10.0
        third = asyncio.ensure_future(page.get())
        first.cancel()
        may_end.set()
        assert await asyncio.gather(second, third) == [b"page"] * 2
        assert len(made) == 1

    asyncio.run(scenario())


def test_scans_are_serialised_on_arrival_and_not_on_request(monkeypatch):
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


def test_asking_since_the_last_scan_skips_and_repeats_none_even_after_the_clock_is_set_back():
    begun = time.time()
    # The clock is set back by an hour after the third, as a person does it on a PC.
    ends = [begun + 5.0 * number - (3600.0 if number > 2 else 0.0) + 1e-4 * number for number in range(6)]
    log, found, since = ScanLog(), [], -math.inf
    for number, end_utc_s in enumerate(ends):
        log.note(replace(scan(number), time_utc_s=end_utc_s))
        page = json.loads(log.page(since))
        found += [item["sequence"] for item in page["scans"]]
        since = parse_query_time("since", page["scans"][-1]["time"])
        assert json.loads(log.page(since)) == {"scans": [], "more": False}
    assert found == list(range(6))
    assert [item["sequence"] for item in json.loads(log.page(begun + 7.0))["scans"]] == [2]


def test_an_event_is_serialised_once_for_all_listeners_and_not_at_all_without_listeners(monkeypatch):
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


def test_a_listener_that_does_not_read_keeps_the_latest_500_events_and_one_that_reads_gets_all():
    async def scenario():
        feed, read = Feed(), []
        with feed.listening() as deaf, feed.listening() as reading:
            for n in range(5000):
                feed.note(Event(float(n), float(n), "test", str(n)))
                read.append(reading.get_nowait())
            assert deaf.qsize() == 500
            assert b'"text":"4500"' in deaf.get_nowait()
        assert [json.loads(event.partition(b"data: ")[2])["text"] for event in read] == [str(n) for n in range(5000)]
        assert len(feed._listeners) == 0

    asyncio.run(scenario())
