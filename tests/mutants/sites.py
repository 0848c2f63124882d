"""Where an error can be made in a source file, and what the file says then.

The kinds are errors that people make in navigation code: a sign, a factor, an index, a unit, a term left out,
a comparison turned round. Left as they are: annotations, assertions, texts with fields.
"""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

_UNITS = {"DEG", "HOUR", "STANDARD_GRAVITY", "deg2rad", "rad2deg", "radians", "degrees"}
_SIGNS: dict[type[ast.operator], type[ast.operator]] = {ast.Add: ast.Sub, ast.Sub: ast.Add}
_FACTORS: dict[type[ast.operator], type[ast.operator]] = {ast.Mult: ast.Div, ast.Div: ast.Mult}
_TURNED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    **{ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn},
    **{ast.Gt: ast.Lt, ast.GtE: ast.LtE, ast.NotEq: ast.Eq, ast.IsNot: ast.Is, ast.NotIn: ast.In},
}
_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Place:
    """Where a piece of source stands, and how coverage sees that it is executed."""

    first: int = 1  # lines of its statement, without the statements inside that
    last: int = 1
    where: str = ""  # function or class around it, dotted
    name: str | None = None  # who uses this name executes it: a kernel, or what is evaluated at the import
    at_import: bool = True


@dataclass(frozen=True)
class Mutant:
    """One error in one file: some of its bytes are others."""

    file: str  # from the root of the tree
    place: Place
    line: int
    kind: str
    start: int  # the bytes that change
    end: int
    text: bytes  # what stands there instead
    before: str  # the lines that change, as they are
    after: str  # and with the error

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What says that two are the same, wherever the lines have moved to."""
        return self.file, self.place.where, self.before, self.after

    def apply(self, source: bytes) -> bytes:
        """Return the file with the error."""
        return source[: self.start] + self.text + source[self.end :]


def walk(node: ast.AST, place: Place | None = None) -> Iterator[tuple[ast.AST, Place]]:
    """Yield each node of a module with its place, but for annotations, assertions and texts with fields."""
    place = place or Place()
    if isinstance(node, ast.stmt):
        place = _at_statement(node, place)
    yield node, place
    for field, value in ast.iter_fields(node):
        inside = _in_body(node, place) if isinstance(node, _Function) and field == "body" else place
        for child in value if isinstance(value, list) else [value]:
            left = field in ("annotation", "returns") or isinstance(child, ast.Assert | ast.JoinedStr)
            if isinstance(child, ast.AST) and not left:
                yield from walk(child, inside)


def _at_statement(node: ast.stmt, place: Place) -> Place:
    body = getattr(node, "body", None)
    first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", []))])
    last = max(node.lineno, body[0].lineno - 1) if body else node.end_lineno or node.lineno
    name, where = place.name, place.where
    if isinstance(node, _Function | ast.ClassDef):
        where = f"{where}.{node.name}".lstrip(".")
        name = node.name if place.at_import else name
    elif isinstance(node, ast.Assign | ast.AnnAssign) and place.at_import and not where:
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        name = next((one.id for one in ast.walk(target) if isinstance(one, ast.Name)), None)
    return replace(place, first=first, last=last, name=name, where=where)


def _in_body(node: _Function, place: Place) -> Place:
    """Return the place of what a function does: coverage sees it, unless numba compiles it."""
    decorators = {ast.unparse(one).rpartition(".")[2] for one in node.decorator_list}
    compiled = decorators & {"kernel", "inner", "intrinsic"} or (not place.at_import and place.name)
    return replace(place, at_import=False, name=(place.name or node.name) if compiled else None)


def find_mutants(path: Path, root: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file, in the order of the source."""
    source, file = path.read_bytes(), path.relative_to(root).as_posix()
    lines = source.splitlines(keepends=True)
    starts = [0, *accumulate(map(len, lines))]
    for node, place in walk(ast.parse(source)):
        for kind, old, new in _find_errors(node):
            assert old.end_lineno is not None
            assert old.end_col_offset is not None
            start, end = (
                starts[old.lineno - 1] + old.col_offset,
                starts[old.end_lineno - 1] + old.end_col_offset,
            )
            text = ast.unparse(new) if isinstance(new, ast.Constant | ast.Name) else f"({ast.unparse(new)})"
            head, tail = starts[old.lineno - 1], starts[old.end_lineno]
            after = source[head:start] + text.encode() + source[end:tail]
            shown = source[head:tail].decode().strip(), after.decode().strip()
            yield Mutant(file, place, old.lineno, kind, start, end, text.encode(), *shown)


def _find_errors(node: ast.AST) -> Iterator[tuple[str, ast.expr, ast.expr]]:
    """Yield the errors that a node allows: the kind, the expression, and what stands there instead."""
    match node:
        case ast.BinOp(left, op, right) if type(op) in _SIGNS and not _is_text(node):
            yield "sign", node, ast.BinOp(left, _SIGNS[type(op)](), right)
            yield "term", node, left
            if isinstance(op, ast.Add):
                yield "term", node, right
        case ast.BinOp(left, op, right) if type(op) in _FACTORS:
            yield "factor", node, ast.BinOp(left, _FACTORS[type(op)](), right)
        case ast.UnaryOp(ast.USub(), operand):
            yield "sign", node, operand
        case ast.BoolOp(op, values):
            for one in values:
                rest = [other for other in values if other is not one]
                yield "term", node, ast.BoolOp(op, rest) if len(rest) > 1 else rest[0]
        case ast.Compare(left, ops, others):
            for k, operator in enumerate(ops):
                turned = [*ops[:k], _TURNED[type(operator)](), *ops[k + 1 :]]
                yield "comparison", node, ast.Compare(left, turned, others)
        case ast.Subscript(slice=index):
            for part in index.elts if isinstance(index, ast.Tuple) else [index]:
                for number in (part.lower, part.upper) if isinstance(part, ast.Slice) else (part,):
                    if isinstance(number, ast.Constant) and type(number.value) is int:
                        yield "index", number, ast.Constant(number.value - 1 if number.value else 1)
        case ast.Call(func, [argument]) if ast.unparse(func).rpartition(".")[2] in _UNITS:
            yield "unit", node, argument
        case ast.Name(id, ast.Load()) if id in _UNITS:
            yield "unit", node, ast.Constant(1.0)
        case ast.Constant(float(value)) if value != 0.0:
            yield "factor", node, ast.Constant(2.0 * value)


def _is_text(node: ast.BinOp) -> bool:
    parts = [part for part in ast.walk(node) if isinstance(part, ast.JoinedStr | ast.Constant)]
    return any(isinstance(part, ast.JoinedStr) or isinstance(part.value, str) for part in parts)


def draw(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """Draw mutants without putting back, each kind as often as the others as long as it lasts."""
    generator = random.Random(seed)
    left: dict[str, list[Mutant]] = {}
    for one in mutants:
        left.setdefault(one.kind, []).append(one)
    drawn: list[Mutant] = []
    while left and len(drawn) < count:
        kind = generator.choice(sorted(left))
        drawn.append(left[kind].pop(generator.randrange(len(left[kind]))))
        left = {kind: rest for kind, rest in left.items() if rest}
    return drawn
