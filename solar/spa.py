"""pvlib's solar position algorithm by itself.

The rest of pvlib imports pandas, scipy and h5py, which the service never uses but which take two thirds of its start
time and of its memory. `pvlib.spa` needs numpy alone.
"""

from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from types import ModuleType


@cache
def load_spa() -> ModuleType:
    """Return `pvlib.spa`; raises `ModuleNotFoundError` where pvlib is not installed."""
    package = find_spec("pvlib")
    found = None if package is None else PathFinder.find_spec("pvlib.spa", package.submodule_search_locations)
    if found is None or found.loader is None:
        raise ModuleNotFoundError("pvlib.spa is not installed", name="pvlib.spa")
    module = module_from_spec(found)
    found.loader.exec_module(module)
    return module
