"""How many numbers somebody chose: settings and constants of the mapper, file by file.

python -m benchmarks.numbers [FOLDER ...]

Settings are fields of the configuration whose default is a number or a switch; constants are numbers that
stand under a name in capitals at the top of a module, each number of a tuple by itself. Without FOLDER:
those of mapping in the plane, `pipeline/slam`.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path

from benchmarks.runner import ROOT

BASES = {"BaseModel", "Settings"}


def counted(source: str) -> tuple[list[str], list[str]]:
    """Names of the settings and of the constants of a module; a tuple's name as often as it holds numbers."""
    settings, constants = [], []
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef) and BASES & {ast.unparse(base) for base in node.bases}:
            settings += [f"{node.name}.{name}" for name, default in _defaults(node) if _chosen(default)]
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                names = [ast.unparse(name) for name in getattr(target, "elts", [target])]
                if all(name.isupper() for name in names):
                    constants += [names[0]] * _numbers(node.value)
    return settings, constants


def _defaults(settings: ast.ClassDef) -> Iterator[tuple[str, ast.expr]]:
    """Fields and their defaults, also those that `Field(...)` is given."""
    for item in settings.body:
        if isinstance(item, ast.AnnAssign) and item.value is not None:
            words = {word.arg: word.value for word in getattr(item.value, "keywords", ())}
            yield ast.unparse(item.target), words.get("default", item.value)


def _chosen(default: ast.expr) -> bool:
    """Whether a default is a number or switch, or a constant by name."""
    return bool(_numbers(default)) or (isinstance(default, ast.Name) and default.id.isupper())


def _numbers(value: ast.expr) -> int:
    """Numbers and switches in an expression of literals; `0.05**2` is one."""
    match value:
        case ast.Tuple(elts=items) | ast.List(elts=items) | ast.Call(args=items):
            return sum(map(_numbers, items))
        case ast.BinOp(left=left, right=right):
            return max(_numbers(left), _numbers(right))
        case ast.UnaryOp(operand=operand):
            return _numbers(operand)
        case _:
            return int(isinstance(value, ast.Constant) and isinstance(value.value, bool | int | float))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="*", metavar="FOLDER", default=[str(ROOT / "pipeline/slam")])
    totals = [0, 0, 0]
    print(f"{'module':32s} {'lines':>6s} {'settings':>8s} {'constants':>9s}")
    for folder in parser.parse_args().folders:
        for path in sorted(Path(folder).glob("*.py")):
            text = path.read_text()
            settings, constants = counted(text)
            row = [text.count("\n"), len(settings), len(constants)]
            totals = [a + b for a, b in zip(totals, row, strict=True)]
            print(f"{path.name:32s} {row[0]:6d} {row[1]:8d} {row[2]:9d}")
    print(f"{'together':32s} {totals[0]:6d} {totals[1]:8d} {totals[2]:9d}")


if __name__ == "__main__":
    main()
