"""Whether the source keeps what its names promise, read from the source itself."""

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGES = ("solar", "drivers", "sim_drivers", "daemon")
MOST_BY_PLACE = 4


class Class(NamedTuple):
    module: str
    name: str
    is_long_record: bool


class Call(NamedTuple):
    place: str
    name: str
    by_place: int


@cache
def found():
    """Return the classes and the calls by name of the whole source, from one walk for both tests that keeps no tree."""
    classes, calls = [], []
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            module = path.relative_to(ROOT).as_posix()
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    long = is_record(node) and sum(map(is_field, node.body)) > MOST_BY_PLACE
                    classes.append(Class(module, node.name, long))
                elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    calls.append(Call(f"{module}:{node.lineno}", node.func.id, len(node.args)))
    return classes, calls


def is_record(node):
    decorators = {ast.unparse(part).partition("(")[0] for part in node.decorator_list}
    return "dataclass" in decorators or any(ast.unparse(base) == "NamedTuple" for base in node.bases)


def is_field(node):
    return isinstance(node, ast.AnnAssign) and not ast.unparse(node.annotation).startswith("ClassVar")


def test_no_two_classes_share_a_name():
    places = defaultdict(list)
    for one in found()[0]:
        if not one.name.startswith("_"):
            places[one.name].append(one.module)
    assert len(places) > 300
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_records_of_more_than_four_fields_are_built_by_keyword():
    classes, calls = found()
    records = {one.name for one in classes if one.is_long_record}
    assert len(records) > 50
    by_place = [f"{one.place} {one.name}" for one in calls if one.name in records and one.by_place > MOST_BY_PLACE]
    assert by_place == []
