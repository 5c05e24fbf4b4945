"""What the loads on VISA have in common as plug-ins: their settings, their line, and how they sweep."""

from functools import partial
from typing import Literal

from pydantic import Field

from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.load.sweep import SweepSettings
from drivers.scpi import ScpiLine
from drivers.settings import LoadSettings, PortPath, SettingsError, VisaResource, exclusive_resource
from drivers.transcript import Tap, no_tap

_LEAST_VOLTAGE_FACTOR = 0.9
"""The lowest voltage of a sweep may be read this much lower without ending it."""


class VisaLoadSettings(LoadSettings):
    """An electronic load that is reached over VISA."""

    resource: VisaResource | None = Field(
        None, examples=["GPIB0::5::INSTR"], description="VISA name of the load: GPIB address, or serial port."
    )
    visa: Literal["py", "ni"] = Field("py", description="VISA library: PyVISA-py, or NI-VISA if it is installed.")
    prologix_port: PortPath | None = Field(
        None,
        examples=["/dev/serial/by-id/usb-Prologix_Prologix_GPIB-USB_Controller_PX8ABCDF-if00-port0"],
        description="Port of a Prologix GPIB-USB adapter that the GPIB address is behind; with PyVISA-py only.",
    )

    def exclusive(self) -> dict[str, str | None]:
        """Return the port of the adapter that the load is behind, or its VISA name if it has no adapter."""
        return exclusive_resource(self.resource, self.prologix_port)


def load_line(settings: VisaLoadSettings, tap: Tap = no_tap) -> ScpiLine:
    """Return the load's line, not yet open; `SettingsError` if the settings do not say where it is."""
    if settings.resource is None:
        raise SettingsError('load.resource is missing: a real load needs its VISA name, such as "GPIB0::5::INSTR"')
    where = VisaSettings(settings.resource, settings.visa, settings.prologix_port, device="load", section="load")
    return ThreadedLine("load", partial(VisaLine, where, tap))


def sweep_settings(settings: LoadSettings) -> SweepSettings:
    """Return how the load sweeps."""
    return SweepSettings(settings.settle_s, _LEAST_VOLTAGE_FACTOR * settings.minimum_voltage_v, settings.deadline_s)
