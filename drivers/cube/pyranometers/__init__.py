"""The cube `modbus-pyranometers`: four digital pyranometers on Modbus, of several makes or by a map of registers."""

from drivers.cube.pyranometers.driver import build
from drivers.cube.pyranometers.settings import SETTINGS

__all__ = ["SETTINGS", "build"]
