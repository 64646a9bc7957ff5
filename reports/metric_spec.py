"""How a number is described: its name, unit, meaning, and the files it is computed from."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class MetricSpec:
    """A number by its dotted path in the metrics: its name, unit, meaning and what it is computed from.

    `sources` are files of the stage; `topics` the bag topics among them. `trusted`: the one of its
    section to go by. `seldom`: left out while it is zero.
    """

    path: str
    label: str
    unit: str
    meaning: str
    sources: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    trusted: bool = False
    seldom: bool = False


@dataclass(frozen=True)
class Section:
    """Numbers under one heading; `hint` says how to read them."""

    title: str
    hint: str
    specs: tuple[MetricSpec, ...]


def section(
    title: str, hint: str, *specs: MetricSpec, sources: tuple[str, ...] = (), topics: tuple[str, ...] = ()
) -> Section:
    """A section; `sources` and `topics` are those of all its numbers that name none."""
    common = (replace(s, sources=s.sources or sources, topics=s.topics or topics) for s in specs)
    return Section(title, hint, tuple(common))


BAG = ("bag/",)
TRAJECTORY = ("trajectory.tum",)
MAP_FILES = ("map.pgm", "map.yaml")
GRAPH = ("graph.g2o", "graph.json")
LOG = ("runlog.csv",)
SEEN = ("truth/trajectory.tum", "truth/map.yaml")
ODOMETRY = ("/odom", "/ground_truth/odom")
TRUTH = ("/ground_truth/odom",)

# Last parts of paths.
MORE_IS_BETTER = (
    "iou",
    "iou_one_cell",
    "coverage",
    "within_one_cell",
    "true_success",
    "goals_truly_reached",
    "min_clearance_m",
)
LESS_IS_BETTER = ("rmse", "max", "mean", "p95", "trans_m", "rot_rad", "visible", "low", "time_s")
