"""Draws docs/develop/house.svg: the rooms and floors, from the contracts in pyproject.toml and the rooms' first lines.

Run `python docs/develop/house.py` after a change; a test compares.
"""

import ast
import textwrap
import tomllib
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

ROOT = Path(__file__).parents[2]
PICTURE = Path(__file__).with_name("house.svg")
WIDTH, MARGIN, GAP, HEAD = 1000, 20, 12, 64
TITLE, LINE = 32, 14
GROUND = ("drivers", "sim_drivers", "solar")
FILLS = {
    "daemon": "#dbe9f6",
    "drivers": "#e6dcf5",
    "sim_drivers": "#f9dede",
    "solar": "#dcf3dc",
    "heliocube": "#fdf1cf",
}
STYLE = (
    "text{font-family:sans-serif;fill:#222}.name{font-size:15px;font-weight:bold}.about{font-size:11.5px}"
    ".note{font-size:12.5px;fill:#555}rect{stroke:#456;stroke-width:1}"
)
# Mean width of a letter in a wide font, as a share of its size.
LETTER = 0.6


class Box(NamedTuple):
    """One room, and where it is drawn [px]."""

    module: str
    lines: list[str]
    left: float
    top: float
    width: float
    height: float


def floors() -> list[list[str]]:
    """Return the rooms of each floor, from the top: the contract's layers, the public module beside the entry."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    inside = [[room.strip() for room in floor.split("|")] for floor in layers]
    return [["heliocube", *inside[0]], *inside[1:], list(GROUND)]


def about(module: str) -> str:
    """Return the first line of a room's own description."""
    place = ROOT.joinpath(*module.split("."))
    text = (place / "__init__.py" if place.is_dir() else place.with_suffix(".py")).read_text()
    return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def laid_out(rows: list[list[str]]) -> list[Box]:
    """Return each room's place; the rooms of a floor share its width, and the longest description sets its height."""
    boxes: list[Box] = []
    top = float(HEAD)
    for row in rows:
        width = (WIDTH - 2 * MARGIN - GAP * (len(row) - 1)) / len(row)
        texts = [textwrap.wrap(about(room), int((width - 20) / (11.5 * LETTER))) for room in row]
        height = TITLE + LINE * max(map(len, texts))
        for place, (room, lines) in enumerate(zip(row, texts, strict=True)):
            boxes.append(Box(room, lines, MARGIN + place * (width + GAP), top, width, height))
        top += height + GAP
    return boxes


def drawn(box: Box) -> str:
    """Return a room as SVG."""
    name = box.module.replace(".", "/") + ("/" if (ROOT / box.module.replace(".", "/")).is_dir() else ".py")
    texts = [f'<text class="name" x="{box.left + 10:g}" y="{box.top + 21:g}">{escape(name)}</text>']
    for number, line in enumerate(box.lines):
        y = box.top + 38 + LINE * number
        texts.append(f'<text class="about" x="{box.left + 10:g}" y="{y:g}">{escape(line)}</text>')
    fill = FILLS[box.module.partition(".")[0]]
    rect = (
        f'<rect x="{box.left:g}" y="{box.top:g}" width="{box.width:g}" height="{box.height:g}" rx="5" fill="{fill}"/>'
    )
    return "\n".join([rect, *texts])


def picture() -> str:
    """Return the whole drawing."""
    boxes = laid_out(floors())
    height = int(boxes[-1].top + boxes[-1].height + MARGIN)
    notes = (
        "Every import goes down: a room imports from floors below its own; rooms of one floor do not know each other.",
        "On the ground, sim_drivers imports solar and the interfaces of drivers; only daemon/rigs imports sim_drivers.",
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}">',
        f"<style>{STYLE}</style>",
        f'<rect x="0" y="0" width="{WIDTH}" height="{height}" fill="#fff" style="stroke:none"/>',
        *[f'<text class="note" x="{MARGIN}" y="{24 + 18 * at}">{escape(note)}</text>' for at, note in enumerate(notes)],
        *[drawn(box) for box in boxes],
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
