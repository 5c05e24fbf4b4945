"""What is reported about an instrument that does not do as it should."""

import pytest

from drivers import errors

KINDS = [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, errors.DeviceError)]


@pytest.mark.parametrize("kind", KINDS)
def test_every_device_error_names_the_instrument_and_what_is_wrong(kind):
    fault = kind("positioner", "is silent")
    assert (str(fault), fault.device, fault.message) == ("positioner: is silent", "positioner", "is silent")
