"""A VISA session as an instrument's line: RS-232, GPIB, or GPIB behind a Prologix adapter.

Through PyVISA-py, or through NI-VISA where that is installed. Not checked on hardware: NI-VISA, and what device clear
does over each kind of GPIB adapter; where clear is not supported the line is drained instead.
"""

import contextlib
import itertools
import os
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NoReturn

from drivers.errors import ConnectError, DeadlineError, DriverMissingError, LinkLostError
from drivers.lines.serial_port import (
    LONGEST_DRAIN_S,
    open_raw,
    port_open_error,
    terminal_errors,
    unsolicited_data_error,
)
from drivers.transcript import Tap, no_tap

_ENDS = {"LF": "\n", "CR": "\r", "LFCR": "\n\r"}
_CONTROL_C = b"\x03"
_LONGEST_LINE = 256
_BITS_PER_BYTE = 10
_LONGEST_ADAPTER_WAIT_S = 3.0
# PyVISA hands out its one manager to a second thread while the first still makes it, and drops it when it is unused.
_manager_lock = threading.Lock()
_managers: dict[str, Any] = {}
# PyVISA-py knows an adapter by its bus number alone: of several with one number the last to be opened takes all the
# instruments. So each gets a number of its own, beyond those of linux-gpib, whatever the instrument's name says.
_adapter_buses = itertools.count(100)


@dataclass(frozen=True, slots=True)
class VisaSettings:
    """How an instrument is connected.

    Attributes
    ----------
    resource
        VISA name, ``ASRL<port>::INSTR`` or ``GPIB<board>::<address>::INSTR``.
    library
        ``py`` for PyVISA-py, ``ni`` for NI-VISA.
    prologix_port
        Serial port of a Prologix adapter that the GPIB address is behind.
    baud_rate, terminator, flow_control
        Of RS-232, as set at the meter: 300 to 19200, LF, CR or LFCR, none or xon-xoff.
    takes_adapter
        Whether its section has a key for such an adapter, for messages.
    device, section
        Its role in the rig and the section of the configuration that it stands in, for messages.
    """

    resource: str
    library: Literal["py", "ni"] = "py"
    prologix_port: str | None = None
    baud_rate: int = 19200
    terminator: Literal["LF", "CR", "LFCR"] = "LF"
    flow_control: Literal["none", "xon-xoff"] = "none"
    takes_adapter: bool = True
    device: str = "voltmeter"
    section: str = "instruments.voltmeter"


class VisaLine:
    """The line to the instrument; blocking, for use in one thread.

    Parameters
    ----------
    settings
        Where the instrument is.
    tap
        Told what is sent and received.
    """

    def __init__(self, settings: VisaSettings, tap: Tap = no_tap) -> None:
        import pyvisa  # noqa: PLC0415 - takes a quarter of a second: loaded only for such an instrument

        self._pyvisa = pyvisa
        self._settings = settings
        self._tap = tap
        self._serial = settings.resource.upper().startswith("ASRL")
        self._port = settings.prologix_port or settings.resource.partition("::")[0]
        if self._serial:
            self._port = self._port[len("ASRL") :]
        self._end = _ENDS[settings.terminator] if self._serial else "\n"
        # The line's own time for a question and its answer comes on top of every deadline.
        self.transfer_s = 2 * _LONGEST_LINE * _BITS_PER_BYTE / settings.baud_rate if self._serial else 0.0
        self._gone_errors: tuple[type[BaseException], ...] = (pyvisa.Error, OSError, *terminal_errors())
        unusable: tuple[type[BaseException], ...] = (*self._gone_errors, ValueError, NotImplementedError)
        self._manager: Any = None
        self._adapter: Any = None
        self._adapter_waits_s = 0.0
        self._resource: Any = None
        try:
            self._open()
        except unusable as error:
            self.close()
            self._refuse_open(error)

    def send(self, text: str) -> None:
        """Send one line."""
        self._write((text + self._end).encode("ascii"))

    def receive(self, within_s: float) -> str:
        """Return the next line; `DeadlineError` if it is not complete in time."""
        return self._read(within_s + self.transfer_s)

    def interrupt(self) -> None:
        """Send control-C, or the bus's device clear."""
        if self._serial:
            self._write(_CONTROL_C)
            return
        with self._translate_errors(), contextlib.suppress(self._pyvisa.Error, NotImplementedError, AttributeError):
            self._resource.clear()

    def drain(self, quiet_s: float) -> None:
        """Read until nothing has come for `quiet_s`; `ConnectError` if it never ends."""
        until_s = time.monotonic() + LONGEST_DRAIN_S + self.transfer_s
        with contextlib.suppress(DeadlineError):
            while time.monotonic() < until_s:
                self._read(quiet_s + self.transfer_s / 10)
            raise unsolicited_data_error(self._settings.device)

    def discard_unsolicited(self) -> bool:
        """Throw away what has come and was not read; return whether it was more than the end of a line.

        Over GPIB nothing comes that is not asked for.
        """
        if not self._serial:
            return False
        with self._translate_errors():
            waiting = self._resource.bytes_in_buffer
            if not waiting:
                return False
            data: bytes = self._resource.read_bytes(waiting)
        self._tap("<", data)
        return bool(data.strip())

    def close(self) -> None:
        """Release the session. PyVISA has one manager for all instruments, and closing it would end their sessions."""
        for part in (self._resource, self._adapter):
            if part is not None:
                with contextlib.suppress(*self._gone_errors, ValueError, AttributeError):
                    session = part.session
                    part.close()
                    # PyVISA-py keeps closed sessions: they would pile up, as a meter that is off is tried for months.
                    getattr(self._manager.visalib, "sessions", {}).pop(session, None)
        self._resource = self._adapter = self._manager = None

    def _open(self) -> None:
        settings = self._settings
        library = "@py" if settings.library == "py" else "@ivi"
        try:
            with _manager_lock:
                self._manager = _managers.setdefault(library, self._pyvisa.ResourceManager(library))
        except (OSError, ValueError) as error:
            message = f"NI-VISA is not installed on this PC; install it, or set {settings.section}.visa to py"
            raise DriverMissingError(settings.device, message) from error
        # PyVISA-py sets a port up before it holds it, even one that another program has set otherwise and reads.
        first = open_raw(settings.device, self._port) if self._port.startswith("/") else None
        try:
            self._open_sessions()
        finally:
            if first is not None:
                os.close(first)

    def _open_sessions(self) -> None:
        name, adapter_port = self._settings.resource, self._settings.prologix_port
        if adapter_port is not None:
            bus = next(_adapter_buses)
            self._adapter = self._manager.open_resource(f"PRLGX-ASRL{bus}::{adapter_port}::INTFC")
            self._hold(self._adapter)
            name = re.sub(r"^GPIB\d*", f"GPIB{bus}", name, flags=re.IGNORECASE)
        self._resource = self._manager.open_resource(name)
        if self._serial:
            self._set_serial()

    def _set_serial(self) -> None:
        constants, resource = self._pyvisa.constants, self._resource
        self._hold(resource)
        resource.baud_rate = self._settings.baud_rate
        resource.data_bits = 8
        resource.parity = constants.Parity.none
        resource.stop_bits = constants.StopBits.one
        xon_xoff = self._settings.flow_control == "xon-xoff"
        resource.flow_control = constants.ControlFlow.xon_xoff if xon_xoff else constants.ControlFlow.none
        resource.read_termination = self._end[-1]
        resource.write_termination = ""

    def _hold(self, resource: Any) -> None:
        """Hold the port exclusively, which PyVISA-py leaves out and NI-VISA does by itself."""
        sessions = getattr(self._manager.visalib, "sessions", None)
        port = getattr(sessions[resource.session], "interface", None) if sessions else None
        if port is not None and hasattr(port, "exclusive"):
            port.exclusive = True

    def _write(self, data: bytes) -> None:
        with self._translate_errors():
            self._set_timeout(1.0 + self.transfer_s)
            self._resource.write_raw(data)
        self._tap(">", data)

    def _read(self, within_s: float) -> str:
        with self._translate_errors():
            self._set_timeout(within_s)
            self._let_adapter_wait(within_s)
            data: bytes = self._resource.read_raw()
        self._tap("<", data)
        return data.decode("latin-1").strip("\r\n")

    def _set_timeout(self, seconds: float) -> None:
        # Behind a Prologix adapter the adapter's own time-out counts.
        for part in (self._adapter, self._resource):
            if part is not None:
                part.timeout = max(1000 * seconds, 1)

    def _let_adapter_wait(self, seconds: float) -> None:
        """Set how long an adapter waits for the next character of its instrument: PyVISA-py leaves it at 50 ms."""
        seconds = min(seconds, _LONGEST_ADAPTER_WAIT_S)
        if self._adapter is not None and seconds != self._adapter_waits_s:
            self._adapter.write_raw(b"++read_tmo_ms %d\n" % max(1000 * seconds, 1))
            self._adapter_waits_s = seconds

    @contextlib.contextmanager
    def _translate_errors(self) -> Iterator[None]:
        try:
            yield
        except self._pyvisa.VisaIOError as error:
            if error.error_code == self._pyvisa.constants.StatusCode.error_timeout:
                raise DeadlineError(self._settings.device, "no line came in time") from error
            raise LinkLostError(self._settings.device, f"{self._settings.resource}: {error}") from error
        except self._gone_errors as error:
            raise LinkLostError(
                self._settings.device, f"{self._settings.resource} is gone; has it been unplugged?"
            ) from error

    def _refuse_open(self, error: BaseException) -> NoReturn:
        settings = self._settings
        if isinstance(error, OSError):
            raise port_open_error(settings.device, self._port, error) from error
        if isinstance(error, ValueError) and not self._serial:
            adapter = f" {settings.section}.prologix_port for a Prologix adapter, or" if settings.takes_adapter else ""
            message = (
                f"{settings.resource} cannot be opened with PyVISA-py: it needs linux-gpib,"
                f' or{adapter} {settings.section}.visa = "ni"'
            )
            raise DriverMissingError(settings.device, message) from error
        raise ConnectError(settings.device, f"{settings.resource} cannot be opened: {error}") from error
