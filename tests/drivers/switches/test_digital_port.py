"""The messages of a DAQ driver."""

import pytest

from drivers.switches.digital_port import DaqError


@pytest.mark.parametrize(("code", "text"), [(-200220, "device is gone (-200220)"), (None, "device is gone")])
def test_an_error_is_said_with_its_number(code, text):
    fault = DaqError(code, "device is gone")
    assert (str(fault), fault.code) == (text, code)
