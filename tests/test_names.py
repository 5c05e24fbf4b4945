"""What the names in the source promise, read from the source itself."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("solar", "drivers", "sim_drivers", "daemon")
MOST_BY_PLACE = 4


def modules():
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def test_no_two_classes_share_a_name():
    places = defaultdict(list)
    for name, tree in modules():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    assert len(places) > 300
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def is_record(node):
    decorators = {ast.unparse(part).partition("(")[0] for part in node.decorator_list}
    return "dataclass" in decorators or any(ast.unparse(base) == "NamedTuple" for base in node.bases)


def is_field(node):
    return isinstance(node, ast.AnnAssign) and not ast.unparse(node.annotation).startswith("ClassVar")


def test_records_of_more_than_four_fields_are_built_by_keyword():
    trees = list(modules())
    records = {
        node.name
        for _, tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and is_record(node) and sum(map(is_field, node.body)) > MOST_BY_PLACE
    }
    assert len(records) > 50
    by_place = [
        f"{name}:{node.lineno} {node.func.id}"
        for name, tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in records
        and len(node.args) > MOST_BY_PLACE
    ]
    assert by_place == []
