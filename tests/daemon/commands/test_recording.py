"""A transcript that a probe writes."""

import sys
import threading

from daemon.commands.recording import record_transcript
from drivers.transcript import parse

PIECES = 20_000


def test_a_transcript_recorded_from_two_threads_has_all_pieces_of_both_in_order(tmp_path):
    told = {direction: [b"%d\r" % number for number in range(PIECES)] for direction in "<>"}
    every_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with record_transcript(tmp_path / "line") as tap:

            def talk(direction):
                for data in told[direction]:
                    tap(direction, data)

            threads = [threading.Thread(target=talk, args=(direction,)) for direction in told]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    finally:
        sys.setswitchinterval(every_s)
    pieces = parse((tmp_path / "line").read_text(encoding="utf-8").splitlines())
    for direction, data in told.items():
        assert [piece.data for piece in pieces if piece.direction == direction] == data
    assert [piece.time_s for piece in pieces] == sorted(piece.time_s for piece in pieces)
