"""The messages of a DAQ driver."""

import pytest

from drivers.switches.digital_port import DaqError


@pytest.mark.parametrize(("code", "text"), [(-200220, "device is gone (-200220)"), (None, "device is gone")])
def test_the_message_of_a_daq_error_has_its_number_if_there_is_one(code, text):
    fault = DaqError(code, "device is gone")
    assert (str(fault), fault.code) == (text, code)
