"""What can go wrong with an instrument. Third-party exceptions become one of these in the driver, nowhere else."""


class DeviceError(Exception):
    """An instrument did not do what was asked.

    Parameters
    ----------
    device
        Role of the instrument in the rig: ``multiplexer``, ``voltmeter``, ``positioner``, ``load``.
    message
        One sentence for the log and the operator.
    """

    def __init__(self, device: str, message: str) -> None:
        super().__init__(f"{device}: {message}")
        self.device = device
        self.message = message


class ConnectError(DeviceError):
    """The instrument could not be reached."""


class DriverMissingError(ConnectError):
    """The software that the instrument needs is not installed on this machine."""


class DriverHungError(ConnectError):
    """Too many calls of the software under the driver have never returned; only a new process can go on."""


class IdentityError(ConnectError):
    """Something answered, but it is not the instrument that was expected."""


class LinkLostError(DeviceError):
    """The link was up and is gone, or has gone silent."""


class DeadlineError(DeviceError):
    """One exchange took longer than its deadline."""


class UnavailableError(DeadlineError):
    """A gateway, or a busy device, says that it cannot give an answer now."""


class ProtocolError(DeviceError):
    """The instrument sent something that its protocol does not allow."""


class OverRangeError(DeviceError):
    """The quantity is beyond the instrument's range, so there is no reading."""


class RefusedError(DeviceError):
    """The instrument is reachable and did not carry out the command."""


class StillMovingError(RefusedError):
    """An axis goes on moving although it was told to stop."""
