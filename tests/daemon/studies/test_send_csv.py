"""The reference sender reads a file strictly and sends it in its own rhythm."""

import asyncio
import gzip
import math
import os
import threading
from datetime import datetime
from random import Random

import pytest

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.base.records import Quality
from daemon.bridge.receiver import BridgeReceiver
from daemon.config.links import BridgeSettings
from daemon.studies.recorded import read_csv
from daemon.studies.send_csv import send_csv
from solar.ephemeris import Site

KEY = bytes(range(1, 33))
SITE = Site(48.7, 2.2, 156.0)
START = "2022-10-14T10:20:00Z"
START_S = datetime.fromisoformat(START).timestamp()
HEADER = "time,east,south,west,zenith\n"
FILE = (
    HEADER
    + "2022-10-14T10:20:00Z,103.2,118.9,98.75,171.4\n"
    + "2022-10-14T10:20:05Z,103.1,,98.8,171.5\n"
    + "2022-10-14T12:20:35+02:00,1,nan,3,4\n"
)


class LeapingLoop(asyncio.SelectorEventLoop):
    """An event loop whose time jumps to the next timer once its sockets are quiet."""

    def __init__(self):
        super().__init__()
        self._leapt_s = 0.0
        really_select = self._selector.select

        def select(timeout=None):
            events = really_select(0)
            if not events and timeout:
                self._leapt_s += timeout
            return events

        self._selector.select = select

    def time(self):
        return self._leapt_s


def written(tmp_path, text, name="cube.csv"):
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.lower().endswith(".gz") else text.encode())
    return path


def sent(path, ahead_s=7200.0, **options):
    """Send the file to a receiver and return (time, scan) for each that it accepted, and the progress told."""

    async def main():
        loop = asyncio.get_running_loop()
        clock = LoopClock(loop.time, START_S + ahead_s)
        got, progress = [], []
        receiver = BridgeReceiver(
            BridgeSettings(listen="127.0.0.1:0"), KEY, clock, lambda scan: got.append((loop.time(), scan))
        )
        await receiver.open()
        settings = BridgeSettings(send_to=(str(receiver.address),))
        try:
            count = await send_csv(
                path,
                settings,
                KEY,
                clock,
                Random(1),
                SITE,
                on_progress=lambda done, total: progress.append((done, total)),
                **options,
            )
            await asyncio.sleep(1.0)
        finally:
            await receiver.close()
        assert count == len(got)
        return got, progress

    with asyncio.Runner(loop_factory=LeapingLoop) as runner:
        return runner.run(main())


@pytest.mark.parametrize("name", ["cube.csv", "cube.csv.gz", "CUBE.CSV.GZ"])
def test_a_file_is_sent_in_its_own_rhythm_stamped_with_the_present_time(tmp_path, name):
    got, progress = sent(written(tmp_path, FILE, name))
    assert [when for when, _ in got] == pytest.approx([0.0, 5.0, 35.0])
    assert [scan.time_utc_s - START_S - 7200.0 for _, scan in got] == pytest.approx([0.0, 5.0, 35.0])
    assert progress == [(1, 3), (2, 3), (3, 3)]
    first, second, _ = (scan for _, scan in got)
    assert [face.irradiance_w_m2 for face in first.faces] == [103.2, 118.9, 98.75, 171.4]
    assert first.ok
    assert first.simulated
    assert second.south.quality is Quality.MISSING
    assert math.isnan(second.south.irradiance_w_m2)
    assert [scan.sequence for _, scan in got] == [0, 1, 2]


def test_missing_readings_in_the_file_are_reported_and_a_last_line_that_breaks_off_is_not_sent(tmp_path):
    told = []
    path = written(tmp_path, FILE + "2022-10-14T12:20:40+02:00,1,2,3")
    got, _ = sent(path, warn=told.append)
    assert len(got) == 3
    assert told == [
        f"{path}: the last line, 5, breaks off at cell 4 of 5 and is left out",
        f"{path}: 2 of 12 readings are missing",
    ]


def test_readings_in_kilowatts_give_a_warning(tmp_path):
    told = []
    path = written(tmp_path, HEADER + f"{START},0.1032,0.1189,0.09875,0.1714\n")
    sent(path, warn=told.append)
    assert told == [f"{path} has at most 0.171 W/m2 on any face by day: if it is in kW/m2, multiply it by 1000"]


def test_a_pipe_is_read_as_a_file(tmp_path):
    pipe = tmp_path / "cube.csv"
    os.mkfifo(pipe)
    writing = threading.Thread(target=pipe.write_text, args=(FILE,), daemon=True)
    writing.start()
    got, _ = sent(pipe)
    writing.join()
    assert len(got) == 3


def test_speed_divides_the_intervals(tmp_path):
    got, _ = sent(written(tmp_path, FILE), speed=10.0)
    assert [when for when, _ in got] == pytest.approx([0.0, 0.5, 3.5])


def test_the_times_of_the_file_can_be_kept(tmp_path):
    got, _ = sent(written(tmp_path, FILE), ahead_s=20.0, keep_times=True)
    assert [scan.time_utc_s for _, scan in got] == [START_S, START_S + 5, START_S + 35]


def test_a_file_may_have_more_columns_in_any_order_blank_lines_and_a_byte_order_mark(tmp_path):
    text = "﻿zenith, note, west ,south,east,time\r\n4,x,3,2,1,2022-10-14T10:20:00\r\n\r\n"
    rows = read_csv(written(tmp_path, text)).rows
    assert [(row.time_utc_s, row.irradiances_w_m2) for row in rows] == [(START_S, (1.0, 2.0, 3.0, 4.0))]


def test_a_number_that_no_face_can_read_is_a_missing_reading_and_is_counted(tmp_path):
    later = "2022-10-14T10:20:05Z"
    recording = read_csv(written(tmp_path, HEADER + f"{START},1,2,-9999,4\n{later},,2,inf,-1e9\n"))
    first, second = (row.irradiances_w_m2 for row in recording.rows)
    assert first == pytest.approx((1.0, 2.0, math.nan, 4.0), nan_ok=True)
    assert second == pytest.approx((math.nan, 2.0, math.nan, math.nan), nan_ok=True)
    assert recording.notes() == [
        "4 of 8 readings are missing",
        "3 of the missing readings are numbers outside -50..2500 W/m2, the first at line 2: west -9999",
    ]
    assert read_csv(written(tmp_path, FILE)).notes() == ["2 of 12 readings are missing"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty: name a CSV file with the columns time,east"),
        ("time,east,west,zenith\n", "line 1: the column south is missing"),
        ("time,east,south,west,zenith,east\n", "line 1 has two columns east: keep only the right one"),
        (HEADER, "has no readings below its header"),
        (HEADER + "yesterday,1,2,3,4\n", "line 2: the time 'yesterday' is not ISO 8601"),
        (HEADER + f"{START},1,2,x,4\n", "line 2: west is 'x', not a number"),
        (HEADER + f"{START},1,2,3\n", "line 2: there are 4 cells where the header has 5"),
        (HEADER + f"{START},1,2,3,4\n\n{START},1,2,3,4\n", "line 4: the time 2022-10-14T10:20:00Z is not later"),
        (
            HEADER + f"{START},1,2,3,4\n2022-10-14T10:19:59Z,1,2,3,4\n",
            "line 3: the time 2022-10-14T10:19:59Z is not later",
        ),
        (HEADER + f'{START},1,2,3,4\n{START},"' + "x" * 200_000 + '",2,3,4\n', "line 3: not CSV"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence_with_the_line(tmp_path, text, words):
    path = written(tmp_path, text)
    with pytest.raises(UserError) as caught:
        sent(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_that_cannot_be_read_is_refused_with_the_reason(tmp_path):
    with pytest.raises(UserError, match="does not exist: name a CSV file with the columns time,east"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(UserError, match="cannot be read: Is a directory"):
        read_csv(tmp_path)
    (tmp_path / "plain.csv.gz").write_text(FILE)
    with pytest.raises(UserError, match=r"is not packed with gzip, though its name ends in \.gz: take the ending off"):
        read_csv(tmp_path / "plain.csv.gz")
    (tmp_path / "short.csv.gz").write_bytes(gzip.compress(FILE.encode())[:-12])
    with pytest.raises(UserError, match="cannot be read"):
        read_csv(tmp_path / "short.csv.gz")
    (tmp_path / "latin.csv").write_bytes("time,é\n".encode("latin-1"))
    with pytest.raises(UserError, match="is not text"):
        read_csv(tmp_path / "latin.csv")


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_a_speed_that_is_no_positive_number_is_refused(tmp_path, speed):
    with pytest.raises(UserError, match="speed"):
        sent(written(tmp_path, FILE), speed=speed)
