import gc
import io
import logging
import re
import warnings

import pytest

from daemon.base import process as logs


@pytest.fixture
def root_logger():
    """Leaves the process' logging as it was."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield root
    root.handlers[:], root.level = handlers, level
    logging.captureWarnings(False)


@pytest.fixture
def written(root_logger):
    def configure(**options):
        stream = io.StringIO()
        logs.configure_logging(stream, **{"journal": True, "level": logging.DEBUG, **options})
        return stream

    return configure


log = logging.getLogger("heliocube.test")


def test_in_the_journal_a_line_begins_with_its_priority_and_has_no_time(written):
    stream = written()
    for level in (logging.DEBUG, logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL):
        log.log(level, "the sun rose")
    assert stream.getvalue().splitlines() == [f"<{n}>the sun rose" for n in (7, 6, 4, 3, 2)]


def test_outside_the_journal_a_line_begins_with_utc_and_level(written):
    stream = written(journal=False)
    log.warning("the wind is strong")
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z WARNING the wind is strong\n", stream.getvalue())


def test_log_fields_follow_the_message_and_are_quoted_where_necessary(written):
    stream = written()
    fields = {
        "down_s": 63.5,
        "n": 3,
        "plain": "/dev/ttyACM0",
        "text": 'said "no"',
        "empty": "",
        "equal": "a=b",
        "two": "a\nb",
        "none": None,
    }
    log.info("back", extra={"fields": fields})
    assert stream.getvalue() == (
        r'<6>back down_s=63.5 n=3 plain=/dev/ttyACM0 text="said \"no\"" empty="" equal="a=b" two="a\nb" none=None'
        "\n"
    )


def test_text_from_a_device_cannot_begin_a_log_line_or_colour_the_terminal(written):
    stream = written()
    log.warning("unit says %s", "ok\n<0>forged\x1b[31m", extra={"fields": {"raw": "\x1b[0m"}})
    assert stream.getvalue() == r'<4>unit says ok\n<0>forged\x1b[31m raw="\x1b[0m"' + "\n"


def test_records_below_the_level_are_left_out(written):
    stream = written(level=logging.WARNING)
    log.info("quiet")
    assert stream.getvalue() == ""


def test_an_unexpected_exception_keeps_its_traceback_and_every_line_its_priority(written):
    stream = written()
    try:
        {}["b"]
    except KeyError:
        log.exception("the task control has died")
    lines = stream.getvalue().splitlines()
    assert lines[0] == "<3>the task control has died"
    assert lines[1] == "<3>Traceback (most recent call last):"
    assert lines[-1] == "<3>KeyError: 'b'"
    assert all(line.startswith("<3>") for line in lines)


def test_warnings_of_the_interpreter_are_logged_in_one_line(written):
    stream = written()
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.warn("old habit", UserWarning, stacklevel=1)
    assert len(stream.getvalue().splitlines()) == 1
    assert "UserWarning: old habit" in stream.getvalue()


def test_objects_made_at_the_start_are_frozen_out_of_garbage_collection():
    made = [[] for _ in range(1000)]
    before = gc.get_freeze_count()
    logs.freeze_startup_objects()
    try:
        assert gc.get_freeze_count() >= before + len(made)
    finally:
        gc.unfreeze()
