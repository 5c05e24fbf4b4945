import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import heliocube

SOUTH_AT_45_DEG = [100.0, 600.0, 100.0, 600.0]
EAST_AND_UP = [500.0, 100.0, 100.0, 400.0]


def test_every_public_name_is_there_and_documented():
    for name in heliocube.__all__:
        assert (getattr(heliocube, name).__doc__ or "").strip(), name
    assert set(heliocube.__all__) <= set(dir(heliocube))


def test_what_tools_read_is_what_is_loaded():
    tree = ast.parse(Path(heliocube.__file__).read_text())
    (typed,) = (node for node in tree.body if isinstance(node, ast.If))
    homes = {alias.name: node.module for node in typed.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert homes.keys() == set(heliocube.__all__) - {"__version__"}
    for name, home in homes.items():
        assert getattr(heliocube, name) is getattr(import_module(home), name)


def test_another_name_is_refused_with_those_that_are_there():
    with pytest.raises(AttributeError, match=r"heliocube has no 'sun'; it has Angles, .*sun_position"):
        _ = heliocube.sun


def test_the_import_loads_no_large_library():
    code = "import heliocube, sys; print(*sorted({'numpy', 'pandas', 'pvlib', 'scipy', 'daemon'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_faces_become_angles_all_at_once():
    faces = np.array([[SOUTH_AT_45_DEG, EAST_AND_UP], [[0.0] * 4, [np.nan] * 4]])
    a_deg, b_deg = heliocube.angles_within(heliocube.mu_prime(faces), heliocube.Limits())
    assert a_deg.shape == b_deg.shape == (2, 2)
    assert (a_deg[0, 0], b_deg[0, 0]) == pytest.approx((0.0, np.degrees(np.arctan2(600.0, 500.0))))
    assert (a_deg[0, 1], b_deg[0, 1]) == pytest.approx((-45.0, 90.0))
    assert np.isnan([a_deg[1], b_deg[1]]).all()
