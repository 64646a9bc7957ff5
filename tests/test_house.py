"""The house stays small: sizes of files, functions and rooms, and the arrows inside the mapper."""

import ast
from collections import Counter
from pathlib import Path

import pytest

from tests.test_layers import ROOT, SOURCES, imported, nodes

LARGEST_FILE, LARGEST_FUNCTION, LARGEST_ROOM = 400, 60, 1400
"""Lines; a room is a folder of `pipeline/slam`."""
MOST_SHARED = 30
"""Constants that one module of the mapper takes from another."""
SLAM = "pipeline/slam"
FLOORS = (
    ("progress", "thin_walls"),
    ("scans",),
    ("graph",),
    ("odometry",),
    ("times",),
    ("sensors",),
    ("loops",),
    ("grid", "sessions"),
    ("check", "walls"),
    ("mapper",),
    ("online", "session_file", "explain"),
)
"""Rooms and modules of the mapper, from the ground up: what lies on a floor imports from below it."""


def lines_of(path: Path) -> int:
    return len(path.read_text().splitlines())


def largest(sizes: Counter[str], limit: int) -> None:
    """Print the three largest, and none may be larger than the limit."""
    ranking = "; ".join(f"{name}: {size} lines" for name, size in sizes.most_common(3))
    print(ranking)
    assert sizes.most_common(1)[0][1] <= limit, ranking


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_no_file_is_longer_than_a_person_reads_at_once():
    largest(Counter({name_of(path): lines_of(path) for path in SOURCES}), LARGEST_FILE)


def test_no_function_is_longer_than_a_screen():
    functions = Counter(
        {
            f"{name_of(path)} {node.name}": node.end_lineno - node.lineno + 1
            for path in SOURCES
            for node in nodes(path)
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        }
    )
    largest(functions, LARGEST_FUNCTION)


def test_no_room_of_the_mapper_outgrows_the_others():
    rooms: Counter[str] = Counter()
    for path in SOURCES:
        folder = path.parent.relative_to(ROOT).as_posix()
        if folder.startswith(f"{SLAM}/"):
            rooms[folder] += lines_of(path)
    assert len(rooms) == 8
    largest(rooms, LARGEST_ROOM)


def floor_of(path: str) -> int:
    """The floor of a module of the mapper, `pipeline/slam/scans/align`."""
    room = path.removeprefix(f"{SLAM}/").partition("/")[0]
    return next(number for number, rooms in enumerate(FLOORS) if room in rooms)


@pytest.mark.parametrize("floor", range(len(FLOORS)), ids=["+".join(rooms) for rooms in FLOORS])
def test_the_mapper_imports_downwards(floor):
    sources = [path for path in SOURCES if name_of(path).startswith(f"{SLAM}/") and path.stem != "__init__"]
    files = [path for path in sources if floor_of(name_of(path).removesuffix(".py")) == floor]
    assert files
    for path in files:
        own = name_of(path).removesuffix(".py").rpartition("/")[0]
        for module in imported(path):
            beside = module.rpartition("/")[0] == own != SLAM
            if module.startswith(f"{SLAM}/") and not beside:
                assert floor_of(module) < floor, f"{name_of(path)} imports {module}"


def test_constants_stay_in_the_module_that_uses_them():
    taken = [
        f"{name_of(path)} takes {alias.name} from {node.module.removeprefix('turtlebag.pipeline.slam.')}"
        for path in SOURCES
        if name_of(path).startswith(f"{SLAM}/")
        for node in nodes(path)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("turtlebag.pipeline.slam.")
        for alias in node.names
        if alias.name.isupper()
    ]
    print(f"{len(taken)} constants of the mapper are imported from another module of it")
    assert len(taken) <= MOST_SHARED, "\n".join(taken)


def test_the_mapper_reads_no_bags():
    for path in SOURCES:
        if name_of(path).startswith(f"{SLAM}/"):
            assert not [name for name in imported(path) if name.startswith("datasets/bags/")], name_of(path)
