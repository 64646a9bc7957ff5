"""The same examples on every run: a failure that CI sees, everyone sees. Nothing is kept between runs."""

import gc
import os
from collections import Counter
from zlib import crc32

import pytest
from hypothesis import settings

from tests.helpers.made_once import made_once
from turtlebag.datasets import kernels
from turtlebag.pipeline.__main__ import GARBAGE_AFTER
from turtlebag.pipeline.terminal.messages import verbosity_kept

# As in the command itself: collecting the tests takes a third less.
gc.set_threshold(GARBAGE_AFTER)

# Made here, or the first command would say that it compiles.
kernels.folder()

settings.register_profile("turtlebag", derandomize=True, deadline=None)
settings.load_profile("turtlebag")


def pytest_collection_modifyitems(items):
    """The longest begin first: begun last, one would run while the other workers have nothing left.

    Files that wait more than they compute lie together in `studio`, and all workers at once would wait there:
    workers take the files as if they were shuffled, always in the same order.
    """
    shuffled = "PYTEST_XDIST_WORKER" in os.environ

    def place(item):
        file = item.nodeid.partition("::")[0]
        return item.get_closest_marker("longest") is None, crc32(file.encode()) if shuffled else 0

    items.sort(key=place)


def pytest_collection_finish():
    """All that was imported and collected stays to the end: no garbage is looked for in it any more."""
    gc.freeze()


def pytest_terminal_summary(terminalreporter):
    """What was not tested here, and why: a line for each reason."""
    reports = [r for r in terminalreporter.getreports("skipped") if isinstance(r.longrepr, tuple)]
    for reason, count in sorted(Counter(r.longrepr[2].removeprefix("Skipped: ") for r in reports).items()):
        terminalreporter.write_line(f"skipped {count}: {reason}")


@pytest.fixture(autouse=True, scope="module")
def messages_as_before():
    """The commands of one file leave the others as quiet as they were."""
    with verbosity_kept():
        yield


@pytest.fixture(scope="session")
def chain(tmp_path_factory):
    """A small chain of good inputs and outputs, to break or to run again; nobody writes to it."""
    from tests.helpers.fuzz_cases import make_chain  # this imports all commands, which most tests do without

    with verbosity_kept():  # it is made before the first file's messages are noted
        return made_once(tmp_path_factory, "chain", make_chain)


@pytest.fixture(scope="session")
def true_map(tmp_path_factory):
    """The arena as it is, at the height of the burger's lidar: the yaml file of a map."""
    from turtlebag.datasets.maps import save_map
    from turtlebag.sim.robots import load_robot
    from turtlebag.sim.worlds import load_world

    grid = load_world("turtlebot3_world").rasterize(load_robot("burger").lidar_height)
    return save_map(grid, tmp_path_factory.mktemp("true"), "arena")
