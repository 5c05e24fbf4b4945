"""Scanning meters as a cube, with answers from manuals and other people's programs."""

import asyncio

import pytest

from drivers.cube.scanning.dialects import DIALECTS
from drivers.cube.scanning.driver import ScanningMeterSettings, build
from drivers.cube.scanning.meter import DEVICE
from drivers.errors import DeadlineError, DeviceError
from drivers.settings import CubeSurroundings


class Published:
    """A line with the answers that manuals and other people's programs show for these instruments."""

    def __init__(self, answers):
        self.answers = answers
        self.sent = []
        self._number = "0"

    async def open(self):
        pass

    async def close(self):
        pass

    async def interrupt(self):
        pass

    async def drain(self, quiet_s):
        pass

    async def discard_unsolicited(self):
        return False

    async def send(self, text):
        self.sent.append(text)
        if text.startswith("*ESE "):
            self._number = text[5:]

    async def receive(self, within_s):
        raise DeadlineError(DEVICE, "no line came in time")

    async def ask(self, text, within_s):
        self.sent.append(text)
        if text == "*ESE?":
            return f"+{self._number}"
        if text not in self.answers:
            raise DeadlineError(DEVICE, "no line came in time")
        return self.answers[text]


AGILENT = {
    "*IDN?": "HEWLETT-PACKARD,34970A,0,13-2-2",
    ":SYST:CTYP? 100": "HEWLETT-PACKARD,34901A,0,1.0",
    ":SYST:ERR?": '+0,"No error"',
    ":SENS:VOLT:DC:RANG? (@101,102,103,104)": "+1.00000000E-01,+1.00000000E-01,+1.00000000E-01,+1.00000000E-01",
    ":SENS:VOLT:DC:NPLC? (@101,102,103,104)": "+1.00000000E+00,+1.00000000E+00,+1.00000000E+00,+1.00000000E+00",
    ":CALC:SCAL:STAT? (@101,102,103,104)": "0,0,0,0",
    ":ROUT:SCAN?": "#218(@101,102,103,104)",
    ":TRIG:SOUR?": "IMM",
    ":FORM:READ:CHAN?": "1",
    ":READ?": "+4.27150000E-03,101,+1.32130000E-03,102,+3.65300000E-03,103,+9.90000000E+37,104",
}
DAQ = {
    "*IDN?": "KEITHLEY INSTRUMENTS,MODEL DAQ6510,04340543,1.7.12b",
    ":SYST:CARD1:IDN?": "7700,20Ch Mux w/CJC,0.0.0a,1234567",
    ":SYST:ERR?": '0,"No error;0;0 0"',
    ":SENS:VOLT:DC:RANG? (@101,102,103,104)": "1.00000000E-01,1.00000000E-01,1.00000000E-01,1.00000000E-01",
    ":SENS:VOLT:DC:NPLC? (@101,102,103,104)": "1,1,1,1",
    ":ROUT:SCAN:COUN:SCAN?": "1",
    DIALECTS["daq6510"].scan: "4.2715E-03,101,1.3213E-03,102,3.653E-03,103,9.9E+37,104",
}


@pytest.mark.parametrize(
    ("range_v", "answer", "problem"),
    [
        ("+1.00000000E-01", "+1.00000000E-01", None),
        ("+1.00000050E-01", "+9.99999500E-02", None),
        ("+1.00000150E-01", "+1.00000000E-01", "RANG"),
        ("+1.00000000E-01", "+9.99998500E-02", "RANG"),
        ("+1.00000000E-01", "AUTO", "RANG"),
    ],
)
def test_a_scanning_meter_that_keeps_another_range_than_asked_on_any_channel_is_refused(range_v, answer, problem):
    asked = ":SENS:VOLT:DC:RANG? (@101,102,103,104)"
    line = Published(AGILENT | {asked: f"{range_v},{answer},{range_v},{range_v}"})
    around = CubeSurroundings(utc_s=lambda: 0.0, monotonic_s=lambda: 0.0, deadline_s=1.0, switched_meter=None)
    settings = ScanningMeterSettings(driver="scanning-meter", meter="agilent34970a", meter_range_v=0.1)
    cube = build(settings, around, line)
    if problem is None:
        asyncio.run(cube.open())
    else:
        with pytest.raises(DeviceError, match=problem):
            asyncio.run(cube.open())


@pytest.mark.parametrize(("meter", "answers"), [("agilent34970a", AGILENT), ("daq6510", DAQ)])
def test_published_answers_of_scanning_meters_are_understood(meter, answers):
    line = Published(answers)
    around = CubeSurroundings(utc_s=lambda: 0.0, monotonic_s=lambda: 0.0, deadline_s=1.0, switched_meter=None)
    cube = build(ScanningMeterSettings(driver="scanning-meter", meter=meter, meter_range_v=0.1), around, line)

    async def act():
        identity = await cube.open()
        return identity, await cube.read()

    identity, reading = asyncio.run(act())
    assert identity == f"{answers['*IDN?']}; slot 1 {answers.get(':SYST:CTYP? 100') or answers[':SYST:CARD1:IDN?']}"
    assert [face.value for face in reading.faces[:3]] == [0.0042715, 0.0013213, 0.003653]
    assert [face.flaw for face in reading.faces] == [None, None, None, "over-range"]
    # One trigger, one reply.
    assert line.sent.count(DIALECTS[meter].scan) == 1


def published(answers, meter="agilent34970a", meter_range_v=0.1):
    line = Published(answers)
    around = CubeSurroundings(utc_s=lambda: 0.0, monotonic_s=lambda: 0.0, deadline_s=1.0, switched_meter=None)
    return build(ScanningMeterSettings(driver="scanning-meter", meter=meter, meter_range_v=meter_range_v), around, line)


@pytest.mark.parametrize(
    ("reply", "flaws"),
    [
        ("+1.209E-01,101,-1.209E-01,102,1E-3,103,1E-3,104", [None] * 4),
        ("+1.211E-01,101,-1.211E-01,102,1E-3,103,1E-3,104", ["over-range"] * 2 + [None] * 2),
        ("+1E-3 VDC,101,1E-3,102,nan,103,,104", [None] * 2 + ["missing"] * 2),
        ("1E-3,101,1E-3,102,1E-3,103,1E-3,104,1E-3", ["missing"] * 4),
        ("1E-3,101,1E-3,102,1E-3,103", ["missing"] * 4),
        ("1E-3,101,1E-3,102,1E-3,103,1E-3,103", ["missing"] * 4),
        ("1E-3,101,1E-3,102,1E-3,103,1E-3,105", ["missing"] * 4),
    ],
)
def test_a_scan_reply_needs_one_reading_of_each_of_four_channels_and_each_within_the_range(reply, flaws):
    async def act():
        cube = published(AGILENT | {":READ?": reply})
        await cube.open()
        return await cube.read()

    assert [face.flaw for face in asyncio.run(act()).faces] == flaws


@pytest.mark.parametrize(
    ("scans", "right"),
    [
        ("(@101:104)", True),
        ('"(@104,103,101:102)"', True),
        ("(@101,102,103)", False),
        ("(@101:105)", False),
        ("(@101:x)", False),
        ("(@x:104)", False),
        ("(@101,,102,103,104)", False),
        ("101,102,103,104", False),
        ("(@101,102,103,104", False),
        ("(A101,102,103,104)", False),
    ],
)
def test_an_answered_channel_list_is_understood_in_every_notation_and_refused_if_wrong(scans, right):
    cube = published(AGILENT | {":ROUT:SCAN?": scans})
    if right:
        asyncio.run(cube.open())
    else:
        with pytest.raises(DeviceError, match=r"did not keep its configuration: :ROUT:SCAN\? is answered by"):
            asyncio.run(cube.open())
