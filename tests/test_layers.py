"""The arrows between the rooms: datasets at the bottom, the command line on top, and no circle anywhere."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BELOW = ["datasets", "sim", "planners", "reports"]
MAY_IMPORT = {
    "datasets": [],
    "sim": ["datasets"],
    "planners": ["datasets"],
    "reports": ["datasets"],
    "pipeline/slam": ["datasets"],
    "pipeline/slam3d": ["datasets", "pipeline/slam"],
    "pipeline/localisation": ["datasets"],
    "pipeline/identify": ["datasets", "sim", "pipeline/slam"],
    "pipeline/terminal": ["datasets", "sim"],
    "pipeline/navigation": [*BELOW, "pipeline/slam", "pipeline/localisation", "pipeline/terminal"],
    "pipeline/twin": ["datasets", "sim", "pipeline/slam", "pipeline/identify"],
}
MAY_IMPORT["pipeline/course"] = [*BELOW, "pipeline/slam"]
MAY_IMPORT["pipeline/studio"] = [*MAY_IMPORT]
MAY_IMPORT["pipeline/stages"] = [*MAY_IMPORT]
MAY_IMPORT["pipeline/campaign"] = [*MAY_IMPORT]
MAY_IMPORT["pipeline/board"] = [*MAY_IMPORT]
MAY_IMPORT["pipeline/setup"] = [*BELOW, "pipeline/stages", "pipeline/navigation", "pipeline/terminal"]
MAY_IMPORT["pipeline/cli"] = [*MAY_IMPORT]
MAY_IMPORT["pipeline/conformance"] = [*BELOW, "pipeline/slam", "pipeline/localisation", "pipeline/navigation"]
MAY_IMPORT["pipeline"] = ["pipeline/cli", "pipeline/setup", "pipeline/conformance", "pipeline/terminal"]
MAY_IMPORT["pipeline/turtlebag"] = [*MAY_IMPORT]
"""Of the files of a room, which other rooms; `pipeline` itself is the door."""

PUBLIC = "pipeline/turtlebag"
"""What `import turtlebag` is."""
SOURCES = sorted(path for room in (*BELOW, "pipeline") for path in (ROOT / room).rglob("*.py"))


def room_of(path: str) -> str:
    """The room that a file or module, `pipeline/slam/align`, belongs to."""
    return max((room for room in MAY_IMPORT if path.startswith(f"{room}/")), key=len)


def path_of(module: str) -> str:
    """Where a module lies, as `datasets/se2`; what is in no folder at the top is of `import turtlebag`."""
    path = module.removeprefix("turtlebag.").replace(".", "/")
    return path if (ROOT / path.partition("/")[0]).is_dir() else f"{PUBLIC}/{path}"


@cache
def nodes(path: Path) -> list[ast.AST]:
    """All of a file's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def imported(path: Path) -> set[str]:
    """Modules of ours that a file imports, as paths.

    Imports for types only and those in functions count, and modules that a string names, which is how
    `importlib` is asked for one.
    """
    found: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and re.fullmatch(r"turtlebag(\.\w+)+", str(node.value)):
            found.add(str(node.value))
    assert "turtlebag" not in found, f"{path}: imports the public API"
    ours = {path_of(name) for name in found if name.startswith("turtlebag.")}
    return {name for name in ours if (ROOT / f"{name}.py").is_file()}


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_imports_follow_the_arrows(room):
    files = [path for path in SOURCES if room_of(str(path.relative_to(ROOT))) == room]
    assert files
    for path in files:
        wrong = {room_of(name) for name in imported(path)} - {room, *MAY_IMPORT[room]}
        assert not wrong, f"{path.relative_to(ROOT)} imports {sorted(wrong)}"


def test_the_table_of_the_docs_has_a_row_for_each_room():
    rows = re.findall(r"^\| `([a-z0-9/]+)` \|", (ROOT / "docs/architecture.md").read_text(), re.M)
    assert sorted(rows) == sorted(set(MAY_IMPORT) - {"pipeline"})


def test_no_imports_go_round_in_a_circle():
    graph = {path.relative_to(ROOT).with_suffix("").as_posix(): imported(path) for path in SOURCES}
    assert sum(map(len, graph.values())) > 1000
    TopologicalSorter(graph).prepare()  # CycleError names the circle


def scripts(page: Path) -> dict[str, set[str]]:
    """The scripts of a page, and which of them each imports."""
    name = re.compile(r"""(?:from|import)\s*\(?\s*["']\./([\w.]+)["']""")
    return {path.name: set(name.findall(path.read_text())) for path in page.glob("*.js")}


def test_no_scripts_of_a_page_import_each_other_in_a_circle():
    graph = scripts(ROOT / "pipeline/studio/static")
    assert len(graph["main.js"]) > 9
    assert set().union(*graph.values()) <= set(graph)
    TopologicalSorter(graph).prepare()  # CycleError names the circle


def test_every_package_is_installed():
    told = re.findall(r'^    "(turtlebag[\w.]*)"', (ROOT / "pyproject.toml").read_text(), re.M)
    folders = {path.parent.relative_to(ROOT).as_posix() for path in SOURCES if path.name == "__init__.py"}
    assert folders == {path.parent.relative_to(ROOT).as_posix() for path in SOURCES}
    places = {folder: f"turtlebag/{folder}".replace(f"turtlebag/{PUBLIC}", "turtlebag") for folder in folders}
    assert set(told) == {place.replace("/", ".") for place in places.values()}


def of_interest(path: Path) -> bool:
    """Whether a file may import a package of ours by another name, or ask for its files."""
    words = "|".join((*BELOW, "pipeline"))
    return re.search(rf"\bfrom\s+(?:{words})\b|\bfiles\(", path.read_text()) is not None


def test_every_package_is_imported_by_one_name():
    # Not what is hidden, as .venv is, which has more files than all the rest, nor what commands left in data.
    for folder in (path for path in ROOT.iterdir() if path.name[0] != "." and path.name != "data"):
        for path in filter(of_interest, folder.rglob("*.py")):
            for node in nodes(path):
                module = node.module if isinstance(node, ast.ImportFrom) else None
                assert (module or "").split(".")[0] not in (*BELOW, "pipeline"), path
                if (
                    isinstance(node, ast.Call)
                    and getattr(node.func, "attr", getattr(node.func, "id", "")) == "files"
                ):
                    package = [arg.value for arg in node.args if isinstance(arg, ast.Constant)]
                    assert all(name.startswith("turtlebag.") for name in package), path


@cache
def names_read(path: Path) -> set[str]:
    """Attributes that a module reads, getattr with a constant name included."""
    found: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "getattr":
            found |= {arg.value for arg in node.args[1:2] if isinstance(arg, ast.Constant)}
    return found


def test_nobody_who_drives_reads_the_truth():
    may = {
        "truth": {"episode.py", "recorder.py"},
        "T_world_base": {"status_lines.py", "recorder.py"},
    }
    folder = ROOT / "pipeline/navigation"
    for name, readers in may.items():
        assert {path.name for path in folder.rglob("*.py") if name in names_read(path)} == readers
    # In the studio those who write it down and those who draw it; not what drives, nor what an input does.
    drawn = {"run_log.py", "publisher.py", "robot.py", "socket_messages.py"}
    for path in (ROOT / "pipeline/studio").rglob("*.py"):
        assert path.name in drawn or not names_read(path) & set(may), path.relative_to(ROOT)
    for package in ("planners", "pipeline/localisation", "pipeline/slam"):
        for path in (ROOT / package).rglob("*.py"):
            assert not names_read(path) & set(may), path.relative_to(ROOT)
