"""Mutants: one small, plausible mistake each, made in the source text so that no line moves.

Not mutated is what no test should pin: annotations, decorators, words (docstrings, messages), and numbers
outside functions, which are settings and tuned constants - another value is another tuning, and the
benchmarks judge it. `<` becomes `<=` only beside whole numbers: between measured lengths it is the same.
"""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FOLDERS = ("pipeline/slam", "pipeline/localisation", "planners", "datasets")
# Code that deletes or fetches, or says what may be deleted, is not handed a mistake on anybody's machine.
DANGEROUS = re.compile(r"rmtree|unlink\(|\.rename\(|os\.replace|pooch|datasets\.claims|def check_free")
KERNEL_SHARE = 0.3
OPERATORS: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
}
REVERSED: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
BY_ONE: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
}
NAMES = {
    "sin": "cos", "cos": "sin", "min": "max", "max": "min", "argmin": "argmax", "argmax": "argmin",
    "floor": "ceil", "ceil": "floor", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any",
    "zeros": "ones", "ones": "zeros", "x": "y", "y": "x", "row": "col", "col": "row", "left": "right",
}  # fmt: skip
# Calls and attributes whose absence is a classic: the argument, or what they were asked of, is left alone.
DROPPED = ("abs", "wrap", "sqrt", "inverse", "T", "sorted", "hypot", "unwrap")
# Of these the order of the arguments does not matter.
COMMUTE = ("min", "max", "minimum", "maximum", "hypot", "array_equal", "isclose", "allclose", "logical_or")
# Kind, start, end, text.
Edit = tuple[str, int, int, str]
NOT_MUTATED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.JoinedStr, ast.Raise, ast.Assert)


@dataclass(frozen=True, order=True)
class Mutant:
    """A replacement of the text `[start, end)` of a file; `key` names it as long as its line stands."""

    path: str
    function: str
    kind: str
    start: int
    end: int
    text: str
    key: str
    kernel: bool

    def applied(self, source: str) -> str:
        """The source with the mistake in it."""
        return source[: self.start] + self.text + source[self.end :]


def mutable_files(root: Path) -> list[str]:
    """Paths below `root` that mutants are drawn from, sorted."""
    files = sorted(path for folder in FOLDERS for path in (root / folder).rglob("*.py"))
    return [str(path.relative_to(root)) for path in files if not DANGEROUS.search(path.read_text())]


def draw(root: Path, seed: int, count: int) -> list[Mutant]:
    """`count` mutants on lines of their own, the same for the same sources and seed; more go on from there.

    A line is drawn first and what is done to it second, so that a rich expression does not weigh more;
    KERNEL_SHARE of them lie in numba kernels.
    """
    rng = random.Random(seed)
    places: dict[bool, list[list[Mutant]]] = {True: [], False: []}
    for path in mutable_files(root):
        for choices in mutants_by_line((root / path).read_text(), path):
            places[choices[0].kernel].append(choices)
    for lines in places.values():
        rng.shuffle(lines)
    drawn: list[Mutant] = []
    for number in range(count):
        due = int(KERNEL_SHARE * (number + 1)) > int(KERNEL_SHARE * number)
        choices = (places[due] or places[not due]).pop()
        source = (root / choices[0].path).read_text()
        random.Random(f"{seed}{choices[0].key}").shuffle(choices)
        drawn.append(next(mutant for mutant in choices if _compiles(mutant.applied(source))))
    return drawn


def mutants_by_line(source: str, path: str) -> list[list[Mutant]]:
    """All mutants of a file, those of one line together."""
    lines: dict[int, list[Mutant]] = {}
    for number, mutant in _Walk(source, path).found():
        lines.setdefault(number, []).append(mutant)
    return [lines[number] for number in sorted(lines)]


class _Walk:
    def __init__(self, source: str, path: str) -> None:
        self.source, self.path = source, path
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.lines = source.splitlines()

    def found(self) -> Iterator[tuple[int, Mutant]]:
        seen: dict[str, int] = {}
        for function, name, kernel in _functions(ast.parse(self.source)):
            for node in _own_nodes(function):
                for kind, start, end, text in self._of(node):
                    number = self.source.count("\n", 0, start) + 1
                    if self.source[start:end] == text or "\n" in self.source[start:end]:
                        continue
                    line = self.lines[number - 1]
                    low = start - self.starts[number - 1]
                    after = line[:low] + text + line[low + end - start :]
                    key = f"{self.path}:{name}: {line.strip()} => {after.strip()}"
                    seen[key] = seen.get(key, 0) + 1
                    if seen[key] > 1:
                        key += f" [{seen[key]}]"
                    yield number, Mutant(self.path, name, kind, start, end, text, key, kernel)

    def _span(self, node: ast.AST) -> tuple[int, int]:
        """Offsets of a node; columns are in UTF-8 bytes."""
        ends = []
        for row, col in ((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)):  # type: ignore[attr-defined]
            line = self.lines[row - 1]
            ends.append(self.starts[row - 1] + len(line.encode()[:col].decode()))
        return ends[0], ends[1]

    def _text(self, node: ast.AST) -> str:
        return self.source[slice(*self._span(node))]

    def _between(self, a: ast.AST, b: ast.AST, old: str) -> tuple[int, int] | None:
        """Where the operator `old` stands between two nodes."""
        low, high = self._span(a)[1], self._span(b)[0]
        at = re.search(rf"(?<![\w<>=!*/]){re.escape(old)}(?![<>=*/])", self.source[low:high])
        return None if at is None else (low + at.start(), low + at.end())

    def _of(self, node: ast.AST) -> Iterator[Edit]:
        match node:
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS and not _is_text(node):
                old, new = OPERATORS[type(op)]
                if where := self._between(left, right, old):
                    yield "operator", *where, new
                if isinstance(op, (ast.Add, ast.Sub, ast.Mult, ast.Div)):
                    yield "term dropped", *self._span(node), self._text(left)
            case ast.AugAssign(target=target, op=op, value=value) if type(op) in OPERATORS:
                old, new = OPERATORS[type(op)]
                low, high = self._span(target)[1], self._span(value)[0]
                at = low + self.source[low:high].index(old)
                yield "operator", at, at + len(old), new
                yield "statement dropped", *self._span(node), "pass"
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                yield from self._comparison(left, op, right)
            case ast.BoolOp(op=op, values=[first, second, *_]):
                old, new = ("and", "or") if isinstance(op, ast.And) else ("or", "and")
                if where := self._between(first, second, old):
                    yield "logic", *where, new
            case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
                yield "sign dropped", *self._span(node), self._text(operand)
            case ast.Constant(value=bool() as value):
                yield "constant", *self._span(node), str(not value)
            case ast.Constant(value=int() as number):
                yield "constant", *self._span(node), str(number + 1)
            case ast.Constant(value=float() as real):
                yield "constant", *self._span(node), repr(2.0 * real if real else 1.0)
            case ast.Name(id=name) | ast.Attribute(attr=name) if name in NAMES:
                end = self._span(node)[1]
                if isinstance(node, ast.Attribute) or name in ("min", "max", "any", "all"):
                    yield "name", end - len(name), end, NAMES[name]
            case ast.Attribute(attr="T", value=value):
                yield "call dropped", *self._span(node), self._text(value)
            case ast.Call():
                yield from self._call(node)
            case ast.Expr(value=ast.Call()) | ast.Continue() | ast.Break():
                yield "statement dropped", *self._span(node), "pass"
            case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
                yield "statement dropped", *self._span(node), "pass"
            case ast.IfExp(body=body, orelse=orelse):
                yield "branch", *self._span(node), f"({self._text(body)})"
                yield "branch", *self._span(node), f"({self._text(orelse)})"

    def _comparison(self, left: ast.expr, op: ast.cmpop, right: ast.expr) -> Iterator[Edit]:
        tables = [REVERSED] + ([BY_ONE] if _is_whole(left) or _is_whole(right) else [])
        for table in tables:
            if type(op) in table:
                old, new = table[type(op)]
                if where := self._between(left, right, old):
                    yield "comparison", *where, new

    def _call(self, node: ast.Call) -> Iterator[Edit]:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in DROPPED and len(node.args) >= 1:
            yield "call dropped", *self._span(node), f"({self._text(node.args[0])})"
        elif name in DROPPED and isinstance(node.func, ast.Attribute):
            yield "call dropped", *self._span(node), self._text(node.func.value)
        for a, b in zip(node.args, node.args[1:], strict=False):
            if (
                name not in COMMUTE
                and isinstance(a, (ast.Name, ast.Attribute, ast.Subscript))
                and type(a) is type(b)
            ):
                low, high = self._span(a)[0], self._span(b)[1]
                middle = self.source[self._span(a)[1] : self._span(b)[0]]
                yield "arguments swapped", low, high, self._text(b) + middle + self._text(a)


def _functions(tree: ast.AST, prefix: str = "", kernel: bool = False) -> Iterator[tuple[ast.AST, str, bool]]:
    """Every function with its qualified name, and whether numba compiles it."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            compiled = kernel or any("njit" in ast.unparse(d) for d in node.decorator_list)
            yield node, prefix + node.name, compiled
            yield from _functions(node, f"{prefix}{node.name}.<locals>.", compiled)
        elif isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.", kernel)
        else:
            yield from _functions(node, prefix, kernel)


def _own_nodes(function: ast.AST) -> Iterator[ast.AST]:
    """What a function does, without the functions in it, annotations and words."""
    stack: list[ast.AST] = list(getattr(function, "body", []))
    while stack:
        node = stack.pop()
        if isinstance(
            node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.JoinedStr, ast.Raise, ast.Assert)
        ):
            continue
        yield node
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            stack.extend(
                item for item in (value if isinstance(value, list) else [value]) if isinstance(item, ast.AST)
            )


def _is_text(node: ast.BinOp) -> bool:
    texts = [n for n in (node.left, node.right) if isinstance(n, (ast.JoinedStr, ast.Constant))]
    return any(not isinstance(getattr(n, "value", None), (int, float)) for n in texts)


def _is_whole(node: ast.expr) -> bool:
    """Whether an expression is certainly a count or an index."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int)
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        return name in ("len", "count_nonzero", "sum", "searchsorted")
    return isinstance(node, ast.Attribute) and node.attr in ("size", "ndim")


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutant", "exec")
    except SyntaxError:
        return False
    return True
