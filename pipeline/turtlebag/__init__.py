"""TurtleBag: reproducible graph-SLAM and navigation for TurtleBot3 bags, without ROS.

    import turtlebag as tb

    bag = tb.record("turtlebot3_world", teleop="tour", seed=1)
    m = tb.map(bag)
    run = tb.navigate(m, task=tb.Patrol(), seed=1)
    tb.report(bag, m, run, out="report")

The steps are those of the command line, and give the same bytes. Nothing is loaded before it is used,
nothing is written unless `out=` names a folder, and nothing is printed (`tb.verbose()` shows progress).
Poses are (x, y, yaw) in metres and radians; what cannot be used raises `tb.InputError`.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from turtlebag.api.making import verbose
    from turtlebag.api.online import Localiser, Mapper
    from turtlebag.api.other_systems import System
    from turtlebag.api.outputs import Bag, Map
    from turtlebag.api.planning import Planner
    from turtlebag.api.results import Comparison, Identification, Localisation, Plan, Report, Run, Twin
    from turtlebag.api.simulation import Simulator
    from turtlebag.api.steps import compare, identify, localise, map, navigate, plan, record, report, twin
    from turtlebag.api.tables import Table, Trajectory
    from turtlebag.api.tasks import Avoid, Explore, Goal, Patrol
    from turtlebag.datasets.errors import InputError
    from turtlebag.datasets.se2 import SE2
    from turtlebag.datasets.types import LidarSpec, Scan
    from turtlebag.planners.planner import NoPath

_HOMES = {
    "turtlebag.api.steps": (
        "record",
        "map",
        "localise",
        "identify",
        "twin",
        "navigate",
        "plan",
        "report",
        "compare",
    ),
    "turtlebag.api.tasks": ("Patrol", "Goal", "Avoid", "Explore"),
    "turtlebag.api.outputs": ("Bag", "Map"),
    "turtlebag.api.results": (
        "Localisation",
        "Identification",
        "Run",
        "Plan",
        "Report",
        "Comparison",
        "Twin",
    ),
    "turtlebag.api.other_systems": ("System",),
    "turtlebag.api.tables": ("Trajectory", "Table"),
    "turtlebag.api.simulation": ("Simulator",),
    "turtlebag.api.online": ("Mapper", "Localiser"),
    "turtlebag.api.planning": ("Planner",),
    "turtlebag.planners.planner": ("NoPath",),
    "turtlebag.api.making": ("verbose",),
    "turtlebag.datasets.errors": ("InputError",),
    "turtlebag.datasets.se2": ("SE2",),
    "turtlebag.datasets.types": ("Scan", "LidarSpec"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "Avoid", "Bag", "Comparison", "Explore", "Goal", "Identification", "InputError", "LidarSpec",
    "Localisation", "Localiser", "Map", "Mapper", "NoPath", "Patrol", "Plan", "Planner", "Report", "Run",
    "SE2", "Scan", "Simulator", "System", "Table", "Trajectory", "Twin", "compare", "identify",
    "localise", "map", "navigate", "plan", "record", "report", "twin", "verbose",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load what is asked for, when it is asked for."""
    if name in ("testing", "envs"):
        return importlib.import_module(f"turtlebag.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'turtlebag' has no attribute '{name}'")
    found = globals()[name] = getattr(importlib.import_module(_HOME[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
