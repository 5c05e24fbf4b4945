"""Small wrong changes of Python source, as a slip of the hand might make them, one at a time.

A change replaces the text of one node of the syntax tree. What no test should depend on is left alone: annotations,
docstrings, log lines, the words of messages, `__repr__`, and that `zip` is strict.
"""

import ast
import copy
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

_OPPOSITE = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
# The bound is moved by one instead of turned round; only with a whole number as bound can a test tell the two apart.
_BOUND = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
_ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_OTHER_CALL = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
_MAY_BE_LEFT_OUT = {"abs", "sorted", "reversed"}
# Options of `zip`, of arrays, of files, and texts for people: no line of ours decides by them.
_NOT_LEFT_OUT = {
    "strict",
    "dtype",
    "encoding",
    "errors",
    "name",
    "extra",
    "exc_info",
    "examples",
    "description",
    "repr",
}
_LOGGERS = {"log", "_log", "logger", "_LOG", "LOG"}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: its file, line and function ("" outside of functions), the replaced part, and the new text."""

    path: str
    line: int
    function: str
    begin: int
    end: int
    text: bytes
    was: str
    now: str

    @property
    def key(self) -> str:
        """Name the change without its line number, so that the name stays when other lines move."""
        return f"{self.path} | {self.was} | {self.now}"

    def applied(self, source: bytes) -> bytes:
        """Return the source with the change."""
        return source[: self.begin] + self.text + source[self.end :]


def mutants(path: str, source: bytes) -> list[Mutant]:
    """Return every change of a file; of two that read the same in one line, only the first."""
    found = {}
    for mutant in _Walk(path, source).changes():
        found.setdefault((mutant.line, mutant.was, mutant.now), mutant)
    return list(found.values())


class _Walk:
    def __init__(self, path: str, source: bytes) -> None:
        self._path = path
        self._source = source
        starts = itertools.accumulate((len(line) for line in source.splitlines(keepends=True)), initial=0)
        self._starts = list(starts)

    def changes(self) -> Iterator[Mutant]:
        yield from self._below(ast.parse(self._source), "", "")

    def _below(self, node: ast.AST, prefix: str, function: str) -> Iterator[Mutant]:
        for child in _worth_changing(node):
            for place, changed in _changed(child):
                yield self._mutant(place, changed, function)
            match child:
                case ast.ClassDef(name=name):
                    yield from self._below(child, f"{prefix}{name}.", "")
                case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                    yield from self._below(child, f"{prefix}{name}.", prefix + name)
                case _:
                    yield from self._below(child, prefix, function)

    def _mutant(self, node: ast.AST, changed: ast.AST | str, function: str) -> Mutant:
        begin = self._starts[node.lineno - 1] + node.col_offset
        end = self._starts[node.end_lineno - 1] + node.end_col_offset
        text = changed if isinstance(changed, str) else ast.unparse(changed)
        if isinstance(node, ast.expr):
            text = f"({text})"
        return Mutant(
            path=self._path,
            line=node.lineno,
            function=function,
            begin=begin,
            end=end,
            text=text.encode(),
            was=_in_a_line(self._source[begin:end].decode()),
            now=_in_a_line(text),
        )


def _in_a_line(text: str) -> str:
    return " ".join(text.split())


def _worth_changing(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the children of a node that mean something when the program runs."""
    for name, value in ast.iter_fields(node):
        if name in {"annotation", "returns", "decorator_list", "type_params", "bases", "type_comment"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_beside_the_point(child):
                yield child


def _is_beside_the_point(node: ast.AST) -> bool:
    match node:
        case ast.JoinedStr() | ast.Import() | ast.ImportFrom():
            return True
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id=name)))) if name in _LOGGERS:
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.FunctionDef(name="__repr__" | "__str__"):
            return True
        case ast.keyword(arg="axis", value=ast.UnaryOp()):
            return True
        case ast.keyword(arg=name):
            return name in _NOT_LEFT_OUT
        case ast.ClassDef(bases=bases):
            return any(isinstance(base, ast.Name) and base.id == "Protocol" for base in bases)
    return False


def _changed(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST | str]]:
    """Yield the changes of a node, each with the node whose text it replaces."""
    match node:
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if isinstance(test, ast.Name | ast.Attribute | ast.Call | ast.Await):
                yield test, ast.UnaryOp(ast.Not(), test)
        case ast.comprehension(ifs=tests):
            for test in tests:
                yield test, ast.Constant(True)
        case _:
            for changed in _replaced(node):
                yield node, changed


def _replaced(node: ast.AST) -> Iterator[ast.AST | str]:
    match node:
        case ast.Compare():
            yield from _comparisons(node)
        case ast.BoolOp():
            yield from _conditions(node)
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
            yield node.operand
        case ast.BinOp() if type(node.op) in _ARITHMETIC and not _is_of_words(node):
            yield _with(node, op=_ARITHMETIC[type(node.op)]())
        case ast.Constant():
            yield from _values(node)
        case ast.Call():
            yield from _calls(node)
        case ast.Expr(value=ast.Call() | ast.Await(value=ast.Call())) | ast.AugAssign() | ast.Raise():
            yield "pass"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.Break() | ast.Continue():
            yield "pass"


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _comparisons(node: ast.Compare) -> Iterator[ast.AST]:
    for place, operator in enumerate(node.ops):
        ops = list(node.ops)
        ops[place] = _OPPOSITE[type(operator)]()
        yield _with(node, ops=ops)
        sides = ([node.left, *node.comparators][place], node.comparators[place])
        if type(operator) in _BOUND and any(_is_whole(side) for side in sides):
            ops = list(node.ops)
            ops[place] = _BOUND[type(operator)]()
            yield _with(node, ops=ops)


def _is_whole(node: ast.AST) -> bool:
    match node:
        case ast.Constant(value=int()):
            return True
        case ast.Call(func=ast.Name(id="len")):
            return True
    return False


def _conditions(node: ast.BoolOp) -> Iterator[ast.AST]:
    yield _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    for place in range(len(node.values)):
        rest = node.values[:place] + node.values[place + 1 :]
        yield rest[0] if len(rest) == 1 else _with(node, values=rest)


def _is_of_words(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    return any(isinstance(side, ast.JoinedStr | ast.List | ast.Tuple) or _is_text(side) for side in sides)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)


def _values(node: ast.Constant) -> Iterator[ast.AST]:
    match node.value:
        case bool():
            yield ast.Constant(not node.value)
        case int() | float() if node.value == 0:
            yield ast.Constant(1)
        case int():
            yield ast.Constant(node.value + 1)
        case float():
            yield ast.Constant(2 * node.value)


def _calls(node: ast.Call) -> Iterator[ast.AST]:
    name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", None)
    if name in _OTHER_CALL:
        other = _OTHER_CALL[name]
        func = ast.Name(other) if isinstance(node.func, ast.Name) else _with(node.func, attr=other)
        yield _with(node, func=func)
    if name in _MAY_BE_LEFT_OUT and len(node.args) == 1 and not node.keywords:
        yield node.args[0]
    # Python itself notices if a field of a record is left out.
    is_record = name is not None and name[0].isupper()
    for place, keyword in enumerate(() if is_record else node.keywords):
        if keyword.arg is not None and keyword.arg not in _NOT_LEFT_OUT:
            yield _with(node, keywords=node.keywords[:place] + node.keywords[place + 1 :])
        if keyword.arg == "axis" and isinstance(keyword.value, ast.UnaryOp):
            # In a table, -1 and 1 are the same axis.
            first = _with(keyword, value=ast.Constant(0))
            yield _with(node, keywords=[*node.keywords[:place], first, *node.keywords[place + 1 :]])
