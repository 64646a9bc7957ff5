"""Every number a report shows: what it means, how it is displayed, and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from reports.stages import Stage

DASH = "\u2013"
# How a unit is shown: factor from the stored SI value, symbol, decimals.
DISPLAY = {
    "cm": (100.0, "cm", 2),
    "m": (1.0, "m", 2),
    "m2": (1.0, "m²", 1),
    "m4": (1.0, "m", 4),
    "cm/m": (100.0, "cm/m", 2),
    "deg": (180.0 / math.pi, "°", 2),
    "deg/m": (180.0 / math.pi, "°/m", 2),
    "deg1": (1.0, "°", 3),
    "s": (1.0, "s", 1),
    "percent": (100.0, "%", 1),
    "count": (1.0, "", 0),
    "plain": (1.0, "", 4),
    "yes": (1.0, "", 0),
}


@dataclass(frozen=True)
class Spec:
    """A number by its dotted path in the metrics: its name, unit, meaning and what it is computed from.

    `sources` are files of the stage; `topics` the bag topics among them.
    """

    path: str
    label: str
    unit: str
    meaning: str
    sources: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()


BAG = ("bag/",)
TRUTH_IN = ("truth/trajectory.tum",)

RECORD = (
    Spec("scans", "scans", "count", "Lidar sweeps in the bag.", BAG, ("/scan",)),
    Spec("duration_s", "duration", "s", "From the first scan to the last, simulated time.", BAG, ("/scan",)),
    Spec("distance_m", "distance driven", "m", "Length of the true path.", BAG, ("/ground_truth/odom",)),
    Spec(
        "odometry_ate_m.rmse",
        "odometry error, RMSE",
        "cm",
        "Wheel odometry against the truth at the scans, no alignment: both start at the same pose.",
        BAG,
        ("/odom", "/ground_truth/odom"),
    ),
    Spec(
        "odometry_ate_m.max",
        "odometry error, largest",
        "cm",
        "Largest distance between wheel odometry and truth.",
        BAG,
        ("/odom", "/ground_truth/odom"),
    ),
    Spec(
        "odometry_rpe.trans_m",
        "odometry drift per metre",
        "cm/m",
        "Relative pose error of the odometry over each metre of true path, RMSE.",
        BAG,
        ("/odom", "/ground_truth/odom"),
    ),
    Spec(
        "odometry_rpe.rot_rad",
        "odometry turn error per metre",
        "deg/m",
        "The same for the heading.",
        BAG,
        ("/odom", "/ground_truth/odom"),
    ),
)

_TRAJECTORY = ("trajectory.tum",)
_MAP = ("map.pgm", "map.yaml")
MAP = (
    Spec("scans", "scans", "count", "Scans that got a pose.", _TRAJECTORY),
    Spec("keyframes", "keyframes", "count", "Scans that are nodes of the pose graph.", ("graph.g2o",)),
    Spec("loops.proposed", "loops proposed", "count", "Candidates for loop closures that were verified."),
    Spec("loops.accepted", "loops accepted", "count", "Loop closures kept in the graph.", ("graph.g2o",)),
    Spec("loops.rejected", "loops rejected", "count", "Proposed loop closures that failed verification."),
    Spec("log_s", "log", "s", "Time span of the scans.", _TRAJECTORY),
    Spec(
        "ate_m.rmse",
        "trajectory error (ATE), RMSE",
        "cm",
        "Root mean square distance between SLAM and true positions at the scans, without alignment.",
        _TRAJECTORY,
    ),
    Spec("ate_m.max", "trajectory error, largest", "cm", "Largest of those distances.", _TRAJECTORY),
    Spec(
        "ate_aligned_m.rmse",
        "trajectory error after alignment, RMSE",
        "cm",
        "The same after the best rigid motion: the shape of the path, not where it starts.",
        _TRAJECTORY,
    ),
    Spec(
        "rpe.trans_m",
        "drift per metre",
        "cm/m",
        "Relative pose error over each metre of true path, RMSE.",
        _TRAJECTORY,
    ),
    Spec("rpe.rot_rad", "turn error per metre", "deg/m", "The same for the heading.", _TRAJECTORY),
    Spec(
        "map.occupied_error_m.mean",
        "wall error, mean",
        "cm",
        "Distance from each occupied map cell to the nearest true surface cell a robot could see.",
        _MAP,
    ),
    Spec("map.occupied_error_m.p95", "wall error, 95 %", "cm", "95 of 100 cells are nearer than this.", _MAP),
    Spec(
        "map.occupied_error_m.within_one_cell",
        "wall cells within one cell",
        "percent",
        "Occupied map cells that touch a true surface cell.",
        _MAP,
    ),
    Spec(
        "map.coverage",
        "surfaces found",
        "percent",
        "True visible surface cells with an occupied map cell on or beside them.",
        _MAP,
    ),
    Spec(
        "map.iou",
        "map IoU",
        "percent",
        "Occupied map cells against true visible surface cells, cell for cell without tolerance: "
        "a wall on a cell border may fall on either side.",
        _MAP,
    ),
    Spec("map.iou_one_cell", "map IoU, one cell tolerance", "percent", "The same, neighbours count.", _MAP),
    Spec("relations.n", "relations", "count", "Hand-made pose relations used.", _TRAJECTORY),
    Spec(
        "relations.trans_m.mean",
        "relations error, mean",
        "m4",
        "Translation error by metricEvaluator's definition (Kümmerle et al. 2009).",
        _TRAJECTORY,
    ),
    Spec(
        "relations.trans_m.std",
        "relations error, standard deviation",
        "m4",
        "How much that error varies from relation to relation.",
        _TRAJECTORY,
    ),
    Spec("relations.rot_deg.mean", "relations turn error, mean", "deg1", "Its absolute yaw.", _TRAJECTORY),
    Spec(
        "relations_cartographer.trans_m.mean",
        "relations error (Cartographer's), mean",
        "m4",
        "Norm of (p1^-1 p2) expected^-1.",
        _TRAJECTORY,
    ),
)

_LOG = ("runlog.csv",)
RUN = (
    Spec("time_s", "time", "s", "Simulated time of the run.", BAG, ("/ground_truth/odom",)),
    Spec("distance_m", "distance driven", "m", "Length of the true path.", BAG, ("/ground_truth/odom",)),
    Spec(
        "takeovers.count",
        "takeovers",
        "count",
        "Times that someone took the commands over from navigation, by the run log's owner of each tick.",
        _LOG,
    ),
    Spec("takeovers.time_s", "time taken over", "s", "Simulated time that navigation did not drive.", _LOG),
    Spec(
        "area.seen_m2",
        "floor seen",
        "m2",
        "True free floor in line of sight of the lidar, within its range, at one of the true poses.",
        (*TRUTH_IN, "truth/map.yaml"),
    ),
    Spec(
        "area.share",
        "floor seen, of what can be seen",
        "percent",
        "Of the floor in such a line from anywhere the robot can get to.",
        (*TRUTH_IN, "truth/map.yaml"),
    ),
    Spec("goals_reached", "goals reached", "count", "Goals the goal checker accepted in time.", BAG),
    Spec(
        "collisions.visible",
        "collisions with visible things",
        "count",
        "Episodes of contact with something that crosses the lidar plane. Counted by the simulator as the "
        "run was made (runlog.csv): a bag holds no contacts.",
        _LOG,
    ),
    Spec(
        "collisions.low",
        "contacts with low things",
        "count",
        "Episodes of contact with something below the lidar plane, by the simulator's run log too.",
        _LOG,
    ),
    Spec(
        "min_clearance_m",
        "least clearance",
        "cm",
        "Footprint to the nearest surface up to the robot's height, at the worst moment, by the simulator's "
        "run log; verify checks that the true path on the true map leaves no less room than that.",
        _LOG,
    ),
    Spec(
        "localisation_error_m.rmse",
        "localisation error, RMSE",
        "cm",
        "Distance between the estimate and the true position at the estimate's stamps.",
        ("trajectory.tum", "bag/"),
        ("/ground_truth/odom",),
    ),
    Spec(
        "localisation_error_m.max",
        "localisation error, largest",
        "cm",
        "Largest of those distances.",
        ("trajectory.tum", "bag/"),
        ("/ground_truth/odom",),
    ),
)

LOCALISE = (
    Spec("scans", "scans", "count", "Scans with a pose.", _TRAJECTORY),
    Spec("updates", "filter updates", "count", "Scans the filter weighed its particles with."),
    Spec(
        "localisation_error_m.rmse",
        "localisation error, RMSE",
        "cm",
        "Distance between the estimate and the true position at the scans.",
        _TRAJECTORY,
    ),
    Spec("localisation_error_m.max", "localisation error, largest", "cm", "Largest of those.", _TRAJECTORY),
    Spec(
        "localisation_error_rad.rmse", "heading error, RMSE", "deg", "The same for the heading.", _TRAJECTORY
    ),
    Spec("converged.share", "time converged", "percent", "Share of the scans with one tight cloud."),
)
GOAL_UNITS = {"time_s": "s", "error_m": "cm", "error_rad": "deg"}
SPECS = {"record": RECORD, "map": MAP, "localise": LOCALISE, "plan": (), "navigate": RUN}


# Inputs of the stage that a number is measured against.
REFERENCES = {
    "ate_m": ("truth",),
    "ate_aligned_m": ("truth",),
    "rpe": ("truth",),
    "map": ("truth",),
    "relations": ("relations",),
    "relations_cartographer": ("relations",),
}


@dataclass(frozen=True, eq=False)
class Number:
    """A value of one stage with its meaning; `key` is `world/stage:path`, unique in a report."""

    key: str
    spec: Spec
    value: Any
    stage: Stage

    @property
    def text(self) -> str:
        """As shown."""
        return shown(self.value, self.spec.unit)

    def evidence(self) -> dict[str, str]:
        """sha256 of each file the number is computed from."""
        sources = self.spec.sources
        found = {
            path: digest
            for path, digest in self.stage.outputs.items()
            if any(path == source or (source.endswith("/") and path.startswith(source)) for source in sources)
        }
        for name in REFERENCES.get(self.spec.path.partition(".")[0], ()):
            files = self.stage.manifest.get("inputs", {}).get(name, {}).get("sha256", {})
            found |= {f"{name}: {path}": digest for path, digest in files.items()}
        return found


def shown(value: Any, unit: str) -> str:
    """A value in the unit's display form; a dash for what is not known."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return DASH
    factor, symbol, digits = DISPLAY[unit]
    gap = "" if symbol in ("", "°", "%") else "\u202f"
    if symbol == "%":
        gap = "\u202f"
    size = factor * value
    if symbol == "cm" and abs(size) >= 10.0:
        digits = 1
    return f"{size:.{digits}f}{gap}{symbol}".replace("-", "\u2212")


def lookup(metrics: Mapping[str, Any], path: str) -> Any:
    """The value at a dotted path; None when a step is missing."""
    node: Any = metrics
    for part in path.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return None
        node = node[part]
    return node


def numbers_of(stage: Stage, metrics: Mapping[str, Any], prefix: str) -> list[Number]:
    """The known numbers of a stage that its metrics hold, in reading order."""
    found = []
    for spec in SPECS[stage.kind]:
        value = lookup(metrics, spec.path)
        if value is not None and not isinstance(value, Mapping):
            found.append(Number(f"{prefix}/{stage.label}:{spec.path}", spec, value, stage))
    return found


def other_values(stage: Stage, metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Leaves of the metrics no Spec names: (dotted path, text)."""
    named = {spec.path for spec in SPECS[stage.kind]}
    return [
        (path, DASH if value is None else f"{value:.6g}" if isinstance(value, float) else str(value))
        for path, value in leaves(metrics)
        if path not in named and not path.startswith("goals.")
    ]


def leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf of nested mappings and lists as (dotted path, value)."""
    if isinstance(node, Mapping):
        for key, item in node.items():
            yield from leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(node, (list, tuple)):
        for index, item in enumerate(node):
            yield from leaves(item, f"{path}.{index}")
    else:
        yield path, node
