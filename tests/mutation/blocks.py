"""The blocks of a function: statements that are reached together, unless something between them raises or returns."""

import ast
import hashlib
from collections.abc import Iterator
from pathlib import Path

HITS = "_reached_blocks"


def digest(file: Path) -> str:
    """Return a text that tells two versions of a source apart."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def block_of_line(path: str, source: bytes) -> dict[int, str]:
    """Return the block, ``path:first line``, of each line of a function; its head belongs to its first block."""
    return {line: f"{path}:{first}" for line, first in _Blocks(ast.parse(source)).of_line.items()}


def marked(path: str, source: bytes, known: list[str]) -> str:
    """Return the source with a mark at the beginning of each block, and append the blocks to the known ones."""
    module = ast.parse(source)
    # From the end, so that earlier places stay valid.
    for statements, place, first in reversed(_Blocks(module).beginnings):
        mark = ast.parse(f"{HITS}[{len(known)}] = 1").body[0]
        statements.insert(place + _is_docstring(statements[place]), mark)
        known.append(f"{path}:{first}")
    place = int(_is_docstring(module.body[0])) if module.body else 0
    module.body.insert(place, ast.parse(f"from {HITS} import HITS as {HITS}").body[0])
    return ast.unparse(ast.fix_missing_locations(module))


class _Blocks:
    def __init__(self, module: ast.Module) -> None:
        self.beginnings: list[tuple[list[ast.stmt], int, int]] = []
        self.of_line: dict[int, int] = {}
        self._outside(module.body)

    def _outside(self, statements: list[ast.stmt]) -> None:
        for statement in statements:
            if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
                self._inside(statement.body, statement.lineno)
            else:
                for inner in _inner(statement):
                    self._outside(inner)

    def _inside(self, statements: list[ast.stmt], head: int) -> None:
        goes_on = False
        first = statements[0].lineno
        for place, statement in enumerate(statements):
            if not goes_on:
                first = statement.lineno
                self.beginnings.append((statements, place, first))
            begin = head if place == 0 else statement.lineno
            self.of_line |= dict.fromkeys(range(begin, (statement.end_lineno or begin) + 1), first)
            inner = list(_inner(statement))
            for block in inner:
                self._inside(block, block[0].lineno)
            goes_on = not inner


def _inner(statement: ast.AST) -> Iterator[list[ast.stmt]]:
    for name in ("body", "orelse", "finalbody"):
        if block := getattr(statement, name, None):
            yield block
    for name in ("handlers", "cases"):
        for part in getattr(statement, name, ()):
            yield part.body


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
