"""A page as a tree of elements: all text is escaped when it is written, as names and reasons come from strangers."""

import io
import re
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from matplotlib import rc_context
from matplotlib.figure import Figure

Node = ET.Element
Part = Node | str

_NUMBER_TEXT = re.compile(r"([+−]?[\d.]+( %| deg)?|–)\Z")
_SHORT = 20
_REFERENCE = re.compile(r"url\(#([^)]+)\)")


def element(tag: str, *parts: Part, **attributes: str) -> Node:
    """Return an element with texts and elements in it; ``class_`` is its class, ``aria_label`` its aria-label."""
    found = ET.Element(tag, {name.rstrip("_").replace("_", "-"): text for name, text in attributes.items()})
    last: Node | None = None
    for part in parts:
        if not isinstance(part, str):
            found.append(part)
            last = part
        elif last is None:
            found.text = (found.text or "") + part
        else:
            last.tail = (last.tail or "") + part
    return found


def table(head: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> Node:
    """Return a table with a caption; the first cell of a row is its heading, and numbers are aligned to the right."""
    return element(
        "div",
        element(
            "table",
            element("caption", caption),
            element("thead", element("tr", *_head(head, rows))),
            element("tbody", *(_row(row) for row in rows)),
        ),
        class_="scroll",
        tabindex="0",
        role="region",
        aria_label=caption,
    )


def picture(figure: Figure, name: str, about: str, colours: dict[str, str]) -> Node:
    """Return a figure as SVG in the page, with its texts as texts and with other colours for those that are named.

    Parameters
    ----------
    figure
        What is drawn.
    name
        Name of this picture in the page: the names of its parts begin with it.
    about
        What it shows, for people who cannot see it.
    colours
        Colours of the figure, such as ``#15191d``, each with the one that replaces it in the page.
    """
    content = io.BytesIO()
    # Without a fixed salt the names of an SVG's parts are random.
    with rc_context({"svg.hashsalt": "heliocube", "svg.fonttype": "none"}):
        figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    root = ET.fromstring(content.getvalue())  # noqa: S314 - our own figure
    used = set(_REFERENCE.findall(content.getvalue().decode())) | {
        value.removeprefix("#") for node in root.iter() for key, value in node.items() if key.endswith("}href")
    }
    for node in root.iter():
        _fit_into_page(node, name, used, colours)
    for metadata in root.findall("metadata"):
        root.remove(metadata)
    svg = element("svg", viewBox=root.get("viewBox", ""), role="img", aria_label=about)
    svg.extend(root)
    return element("figure", element("div", svg, class_="scroll", tabindex="0", role="group", aria_label=about))


def page(title: str, style: str, *parts: Part) -> str:
    """Return the text of a page."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        # The page runs no script and fetches nothing.
        element(
            "meta",
            http_equiv="Content-Security-Policy",
            content="default-src 'none'; style-src 'unsafe-inline'",
        ),
        element("title", title),
        element("style", style),
    )
    whole = element("html", head, element("body", *parts), lang="en")
    return "<!doctype html>\n" + ET.tostring(whole, encoding="unicode", method="html") + "\n"


def _head(texts: Sequence[str], rows: Sequence[Sequence[str]]) -> list[Node]:
    """Return the cells of a table's head, each aligned as its column is."""
    below = rows[0] if rows else [""] * len(texts)
    first, *others = zip(texts, below, strict=True)
    found = [element("th", first[0], scope="col")]
    for text, cell in others:
        # An empty text is no heading.
        found.append(element("th", text, scope="col", class_=_kind(cell)) if text else element("td"))
    return found


def _kind(text: str) -> str:
    """Return the class of a cell: figures are set on the right, short texts in one line."""
    if _NUMBER_TEXT.match(text):
        return "figure"
    return "short" if len(text) <= _SHORT else "words"


def _row(cells: Sequence[str]) -> Node:
    first, *others = cells
    found = element("tr", element("th", first, scope="row", class_="words" if len(first) > _SHORT else "short"))
    for text in others:
        found.append(element("td", text, class_=_kind(text)))
    return found


def _fit_into_page(node: Node, name: str, used: set[str], colours: dict[str, str]) -> None:
    """Make an element of a drawing fit the page: without namespaces, with unique names and the page's colours."""
    node.tag = node.tag.rpartition("}")[2]
    for key, value in list(node.items()):
        del node.attrib[key]
        plain = key.rpartition("}")[2]
        if plain == "id":
            if value in used:
                node.set("id", f"{name}-{value}")
            continue
        text = _REFERENCE.sub(rf"url(#{name}-\1)", value)
        if plain == "href":
            text = f"#{name}-{value.removeprefix('#')}"
        for old, new in colours.items():
            text = text.replace(old, new)
        node.set(plain, text)
