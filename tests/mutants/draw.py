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
DANGEROUS = re.compile(r"rmtree|unlink\(|\.rename\(|os\.replace|pooch|datasets\.output_lock|def check_free")
KERNEL_SHARE = 0.3
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
REVERSED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
BY_ONE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt
}  # fmt: skip
NAMES = {
    "sin": "cos", "cos": "sin", "min": "max", "max": "min", "argmin": "argmax", "argmax": "argmin",
    "floor": "ceil", "ceil": "floor", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any",
    "zeros": "ones", "ones": "zeros", "x": "y", "y": "x", "row": "col", "col": "row", "left": "right",
}  # fmt: skip
BUILT_IN = ("min", "max", "any", "all")
# Calls and attributes whose absence is a classic: the argument, or what they were asked of, is left alone.
DROPPED = ("abs", "wrap", "sqrt", "inverse", "sorted", "hypot", "unwrap")
# Of these the order of the arguments does not matter.
COMMUTE = ("min", "max", "minimum", "maximum", "hypot", "array_equal", "isclose", "allclose", "logical_or")
COUNTS = ("len", "count_nonzero", "sum", "searchsorted")
NOT_MUTATED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.JoinedStr, ast.Raise, ast.Assert)
Edit = tuple[str, ast.AST]
"""Kind, and what stands in the place of a node."""


@dataclass(frozen=True, order=True)
class Mutant:
    """A replacement of the text `[start, end)` of a file; `key` names it as long as its line stands."""

    path: str
    kind: str
    start: int
    end: int
    text: str
    key: str
    kernel: bool

    def applied(self, source: str) -> str:
        """The source with the mistake in it."""
        return source[: self.start] + self.text + source[self.end :]


def draw(root: Path, seed: int, count: int) -> list[Mutant]:
    """`count` mutants on lines of their own, the same for the same sources and seed; more go on from there.

    A line is drawn first and what is done to it second, so that a rich expression does not weigh more;
    KERNEL_SHARE of them lie in numba kernels.
    """
    rng = random.Random(seed)
    places: dict[bool, list[list[Mutant]]] = {True: [], False: []}
    for path in sorted(path for folder in FOLDERS for path in (root / folder).rglob("*.py")):
        if not DANGEROUS.search(source := path.read_text()):
            for choices in mutants_by_line(source, str(path.relative_to(root))):
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
    starts, seen, found = [0], dict[str, int](), dict[int, list[Mutant]]()
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for function, name, kernel in _functions(ast.parse(source)):
        for node in _own_nodes(function):
            for kind, other in _edits(node):
                number, text = node.lineno, ast.unparse(other)  # type: ignore[attr-defined]
                line = source[starts[number - 1] : starts[number]]
                # Columns are in UTF-8 bytes.
                ends = (node.col_offset, node.end_col_offset)  # type: ignore[attr-defined]
                low, high = (len(line.encode()[:column].decode()) for column in ends)
                if node.end_lineno != number or line[low:high] == text:  # type: ignore[attr-defined]
                    continue
                key = f"{path}:{name}: {line.strip()} => {(line[:low] + text + line[high:]).strip()}"
                seen[key] = seen.get(key, 0) + 1
                key += f" [{seen[key]}]" if seen[key] > 1 else ""
                start, end = starts[number - 1] + low, starts[number - 1] + high
                found.setdefault(number, []).append(Mutant(path, kind, start, end, text, key, kernel))
    return [found[number] for number in sorted(found)]


def _edits(node: ast.AST) -> Iterator[Edit]:
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS and not _is_text(node):
            yield "operator", ast.BinOp(left, OPERATORS[type(op)](), right)
            if isinstance(op, (ast.Add, ast.Sub, ast.Mult, ast.Div)):
                yield "term dropped", left
        case ast.AugAssign(target=target, op=op, value=value) if type(op) in OPERATORS:
            yield "operator", ast.AugAssign(target, OPERATORS[type(op)](), value)
            yield "statement dropped", ast.Pass()
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            yield "comparison", ast.Compare(left, [REVERSED[type(op)]()], [right])
            if type(op) in BY_ONE and (_is_whole(left) or _is_whole(right)):
                yield "comparison", ast.Compare(left, [BY_ONE[type(op)]()], [right])
        case ast.BoolOp(op=op, values=values):
            yield "logic", ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield "sign dropped", operand
        case ast.Constant(value=bool() as value):
            yield "constant", ast.Constant(not value)
        case ast.Constant(value=int() as number):
            yield "constant", ast.Constant(number + 1)
        case ast.Constant(value=float() as real):
            yield "constant", ast.Constant(2.0 * real if real else 1.0)
        case ast.Name(id=name) if name in BUILT_IN:
            yield "name", ast.Name(NAMES[name])
        case ast.Attribute(value=value, attr=name) if name in NAMES:
            yield "name", ast.Attribute(value, NAMES[name])
        case ast.Attribute(attr="T", value=value):
            yield "call dropped", value
        case ast.Call():
            yield from _call_edits(node)
        case ast.Expr(value=ast.Call()) | ast.Continue() | ast.Break():
            yield "statement dropped", ast.Pass()
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
            yield "statement dropped", ast.Pass()
        case ast.IfExp(body=body, orelse=orelse):
            yield "branch", body
            yield "branch", orelse


def _call_edits(node: ast.Call) -> Iterator[Edit]:
    name = _called(node)
    if name in DROPPED and node.args:
        yield "call dropped", node.args[0]
    elif name in DROPPED and isinstance(node.func, ast.Attribute):
        yield "call dropped", node.func.value
    for k, (a, b) in enumerate(zip(node.args, node.args[1:], strict=False)):
        plain = isinstance(a, (ast.Name, ast.Attribute, ast.Subscript)) and type(a) is type(b)
        if name not in COMMUTE and plain:
            swapped = [*node.args[:k], b, a, *node.args[k + 2 :]]
            yield "arguments swapped", ast.Call(node.func, swapped, node.keywords)


def _called(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


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
        if not isinstance(node, NOT_MUTATED):
            yield node
            annotation = getattr(node, "annotation", None)
            stack.extend(child for child in ast.iter_child_nodes(node) if child is not annotation)


def _is_text(node: ast.BinOp) -> bool:
    texts = [n for n in (node.left, node.right) if isinstance(n, (ast.JoinedStr, ast.Constant))]
    return any(not isinstance(getattr(n, "value", None), (int, float)) for n in texts)


def _is_whole(node: ast.expr) -> bool:
    """Whether an expression is certainly a count or an index."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int)
    if isinstance(node, ast.Call):
        return _called(node) in COUNTS
    return isinstance(node, ast.Attribute) and node.attr in ("size", "ndim")


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutant", "exec")
    except SyntaxError:
        return False
    return True
