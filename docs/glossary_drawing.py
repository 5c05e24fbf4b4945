"""Draws docs/glossary.svg: the faces of the cube and the tracker's angles A and B.

Run `python docs/glossary_drawing.py` after a change; a test compares. Needs no library and no font.
"""

from collections.abc import Iterator
from math import cos, radians, sin
from pathlib import Path

PICTURE = Path(__file__).with_name("glossary.svg")
WIDTH, HEIGHT, PANEL, GROUND = 960, 380, 320, 300
MODULE, NORMAL = 70, 105
LIMITS_A, LIMITS_B = (-50, 50), (15, 90)
# Okabe and Ito's colours; each plane also has a line of its own, which is left in grey.
STYLE = """
svg{--ground:#ffffff;--ink:#15191d;--faint:#6b747d;--fill:#e8edf2;--one:#0072b2;--two:#b34700;--three:#00795a}
@media(prefers-color-scheme:dark){svg{--ground:#14181c;--ink:#eceff2;--faint:#9aa4ae;--fill:#2a323a;--one:#56b4e9;
--two:#e69f00;--three:#3ad6a8}}
text{font-family:sans-serif;font-size:18px;fill:var(--ink)}
.title{font-size:21px;font-weight:bold}.note{font-size:15.5px;fill:var(--faint)}.mid{text-anchor:middle}
.end{text-anchor:end}.box{fill:var(--fill);stroke:var(--ink);stroke-width:1.5}
.line{stroke:var(--faint);stroke-width:1.5;fill:none}
.one{stroke:var(--one)}.two{stroke:var(--two);stroke-dasharray:7 4}.three{stroke:var(--three);stroke-dasharray:2 4}
.plane{stroke-width:6}.normal{stroke-width:2;stroke-dasharray:none}
"""
CLASSES = ("one", "two", "three")


def picture() -> str:
    """Return the drawing as SVG."""
    parts = "\n".join([*cube(), *tilts_a(), *tilts_b()])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        f'role="img" aria-label="The faces of the cube seen from above; angle A seen from the south; angle B seen from '
        f'the east">\n<style>{STYLE}</style>\n'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 0L8 4L0 8Z" fill="context-stroke"/></marker></defs>\n'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="var(--ground)"/>\n{parts}\n</svg>\n'
    )


def cube() -> Iterator[str]:
    """Yield the cube from above, north up, with its faces."""
    x, y, half, reach = PANEL / 2, 195, 50, 105
    yield heading(0, "The cube", "seen from above, north up")
    yield f'<rect class="box" x="{x - half:g}" y="{y - half:g}" width="{2 * half}" height="{2 * half}"/>'
    for right, down, name in ((1, 0, "east"), (0, 1, "south"), (-1, 0, "west")):
        start, end = (x + right * half, y + down * half), (x + right * reach, y + down * reach)
        yield line("line normal", start, end, tip=True)
        where = {"east": (end[0], y - 10), "west": (end[0], y - 10), "south": (x + 38, end[1] - 8)}[name]
        yield text("mid", where, name)
    yield f'<circle class="line" cx="{x:g}" cy="{y:g}" r="9"/><circle cx="{x:g}" cy="{y:g}" r="3" fill="var(--ink)"/>'
    yield text("mid", (x, y + 36), "zenith")
    yield line("line", (x, y - half - 14), (x, y - reach), tip=True)
    yield text("mid note", (x + 16, y - reach + 14), "N")
    yield text("mid note", (x, GROUND + 62), "four sensors; the north has none")


def tilts_a() -> Iterator[str]:
    """Yield the module at three angles A, seen from the south: east is on the right."""
    x, y = 1.5 * PANEL, GROUND - 70
    yield heading(PANEL, "Angle A", "seen from the south, with B = 90")
    yield ground(PANEL, "west", "east")
    for name, a_deg, label in zip(CLASSES, (0, LIMITS_A[0], LIMITS_A[1]), ("A 0", "A -50", "A +50"), strict=True):
        # The normal leans to the east, which is right here, for a negative A.
        yield from module(name, (x, y), (-sin(radians(a_deg)), cos(radians(a_deg))), label)
    yield text("mid note", (x, GROUND + 62), "minus is east, plus is west")


def tilts_b() -> Iterator[str]:
    """Yield the module at three angles B, seen from the east: south is on the left."""
    x, y = 2.55 * PANEL, GROUND - 70
    yield heading(2 * PANEL, "Angle B", "seen from the east, with A = 0")
    yield ground(2 * PANEL, "south", "north")
    for name, b_deg in zip(CLASSES, (LIMITS_B[1], 45, LIMITS_B[0]), strict=True):
        yield from module(name, (x, y), (-cos(radians(b_deg)), sin(radians(b_deg))), f"B {b_deg}")
    yield text("mid note", (2.5 * PANEL, GROUND + 62), "90 is flat, 15 is nearly upright")


def module(name: str, pivot: tuple[float, float], normal: tuple[float, float], label: str) -> Iterator[str]:
    """Yield a module, seen edge on, and its normal with a label; `normal` is right and up."""
    (x, y), (right, up) = pivot, normal
    yield line(f"{name} plane", (x - MODULE * up, y - MODULE * right), (x + MODULE * up, y + MODULE * right))
    yield line(f"{name} normal", (x, y), (x + NORMAL * right, y - NORMAL * up), tip=True)
    yield text("mid", (x + (NORMAL + 38) * right, y - (NORMAL + 18) * up + 4), label)


def heading(left: float, title: str, note: str) -> str:
    """Return what stands above a panel."""
    return text("mid title", (left + PANEL / 2, 32), title) + text("mid note", (left + PANEL / 2, 58), note)


def ground(left: float, one: str, other: str) -> str:
    """Return the ground of a panel with the directions at its ends."""
    y, right = GROUND + 12, left + PANEL
    return (
        line("line", (left + 20, y), (right - 20, y))
        + text("note", (left + 22, y + 22), one)
        + text("note end", (right - 22, y + 22), other)
    )


def line(name: str, start: tuple[float, float], end: tuple[float, float], *, tip: bool = False) -> str:
    """Return a straight line, with an arrow's tip at its end if wanted."""
    (x1, y1), (x2, y2) = start, end
    marker = ' marker-end="url(#tip)"' if tip else ""
    return f'<line class="{name}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"{marker}/>'


def text(name: str, at: tuple[float, float], words: str) -> str:
    """Return words at a place."""
    return f'<text class="{name}" x="{at[0]:.1f}" y="{at[1]:.1f}">{words}</text>'


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
