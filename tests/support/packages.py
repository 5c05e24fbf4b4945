"""A third party's package, as an installer leaves it in a folder on the path."""

import sys


def install(monkeypatch, folder, points, sources, name="acme"):
    """Write a package into a folder: the sources of its modules, by name, and its entry points, as entry_points.txt.

    When the test ends, the folder leaves the path, and the modules are unloaded.
    """
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(folder)
    for module, source in sources.items():
        (folder / f"{module}.py").write_text(source)
        monkeypatch.setitem(sys.modules, module, None)
        monkeypatch.delitem(sys.modules, module)
