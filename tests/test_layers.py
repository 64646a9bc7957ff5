"""The arrows between the packages: datasets at the bottom, pipeline on top."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "datasets": set(),
    "sim": {"datasets"},
    "planners": {"datasets"},
    "reports": {"datasets"},
    "pipeline": {"datasets", "sim", "planners", "reports"},
}


def imported_packages(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add((node.module or "").split(".")[0])
    return found & set(MAY_IMPORT)


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_follow_the_arrows(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        wrong = imported_packages(path) - MAY_IMPORT[package] - {package}
        assert not wrong, f"{path.relative_to(ROOT)} imports {sorted(wrong)}"


def names_read(path: Path) -> set[str]:
    """Attributes that a module reads, getattr with a constant name included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "getattr":
            found |= {arg.value for arg in node.args[1:2] if isinstance(arg, ast.Constant)}
    return found


def test_nobody_who_drives_reads_the_truth():
    may = {"truth": {"episode.py", "recorder.py"}, "T_world_base": {"metrics.py", "news.py", "recorder.py"}}
    folder = ROOT / "pipeline/navigation"
    for name, readers in may.items():
        assert {path.name for path in folder.rglob("*.py") if name in names_read(path)} == readers
    for package in ("planners", "pipeline/localisation", "pipeline/slam"):
        for path in (ROOT / package).rglob("*.py"):
            assert not names_read(path) & set(may), path.relative_to(ROOT)
