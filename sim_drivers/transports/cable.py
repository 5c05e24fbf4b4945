"""A cable that can be pulled, and the session over it."""

from drivers.errors import ConnectError, LinkLostError


class Cabled:
    """An instrument on a cable.

    Parameters
    ----------
    device
        Role of the instrument, for its errors.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._is_up = True
        self._is_open = False

    @property
    def link_up(self) -> bool:
        """Whether the cable is plugged in. A session whose cable was pulled stays dead until `open`."""
        return self._is_up

    @link_up.setter
    def link_up(self, up: bool) -> None:
        pulled = self._is_up and not up
        self._is_up = up
        if pulled:
            self._is_open = False
            self._pulled()

    def _pulled(self) -> None:
        """Let the instrument do what it does when its cable is pulled; most just go on."""

    def _connect(self) -> None:
        if not self._is_up:
            raise ConnectError(self._device, "is not plugged in")
        if self._is_open:
            # As with a real port: a caller that opens it anew has to close it first.
            raise ConnectError(self._device, "is in use already")
        self._is_open = True

    def _disconnect(self) -> None:
        self._is_open = False

    def _require_open(self) -> None:
        if not self._is_open:
            raise LinkLostError(self._device, "has to be opened first" if self._is_up else "is unplugged")
