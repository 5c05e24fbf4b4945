"""Somebody else's package, as an installer leaves it in a folder on the path."""

import sys


def install(monkeypatch, folder, points, sources, name="acme"):
    """Put the sources of modules, by name, and what the package offers, as entry_points.txt says it, into a folder.

    The folder is on the path, and what the modules put into memory is forgotten, when the test has ended.
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
