"""Which numbers a report shows of each stage, in which order and under which headings."""

from __future__ import annotations

from dataclasses import replace

from turtlebag.reports.metric_spec import (
    BAG,
    GRAPH,
    LOG,
    MAP_FILES,
    ODOMETRY,
    TRAJECTORY,
    TRUTH,
    MetricSpec,
    Section,
    section,
)
from turtlebag.reports.metric_specs_map import MAP
from turtlebag.reports.metric_specs_run import LARGEST_ERROR, RUN

RECORD = (
    section(
        "Recording",
        "",
        MetricSpec("scans", "scans", "count", "Lidar sweeps in the bag.", topics=("/scan",)),
        MetricSpec(
            "duration_s",
            "duration",
            "s",
            "From the first scan to the last, simulated time.",
            topics=("/scan",),
        ),
        MetricSpec("distance_m", "distance driven", "m", "Length of the true path.", topics=TRUTH),
        sources=BAG,
    ),
    section(
        "Wheel odometry error",
        "Odometry errors accumulate; mapping has to correct them.",
        MetricSpec(
            "odometry_ate_m.rmse",
            "odometry error, RMSE",
            "cm",
            "Wheel odometry against the truth at each scan, without alignment: both start at the same pose.",
        ),
        MetricSpec(
            "odometry_ate_m.max",
            "odometry error, largest",
            "cm",
            "Largest distance between wheel odometry and truth.",
        ),
        MetricSpec(
            "odometry_rpe.trans_m",
            "odometry drift per metre",
            "cm/m",
            "Relative pose error of the odometry over each metre of true path, RMSE.",
        ),
        MetricSpec(
            "odometry_rpe.rot_rad", "odometry heading error per metre", "deg/m", "The same for the heading."
        ),
        sources=BAG,
        topics=ODOMETRY,
    ),
)

LOCALISE = (
    section(
        "Localisation",
        "",
        MetricSpec(
            "true_success",
            "localised (ground truth)",
            "yes",
            "At the end the filter had converged, and it was within 25 cm of the truth.",
            TRAJECTORY,
        ),
        MetricSpec(
            "success",
            "localised (filter's estimate)",
            "yes",
            "At the end the filter had converged, and the scans agreed with the map.",
        ),
        MetricSpec(
            "last_error_m",
            "error at the end",
            "cm",
            "Distance between the estimate and the true position at the last scan.",
            TRAJECTORY,
        ),
        MetricSpec(
            "localisation_error_m.rmse",
            "localisation error, RMSE",
            "cm",
            "Distance between the estimate and the true position at the scans.",
            TRAJECTORY,
            trusted=True,
        ),
        replace(LARGEST_ERROR, sources=TRAJECTORY),
        MetricSpec(
            "localisation_error_rad.rmse",
            "heading error, RMSE",
            "deg",
            "The same for the heading.",
            TRAJECTORY,
        ),
    ),
    section(
        "Filter state",
        "",
        MetricSpec("scans", "scans", "count", "Scans with a pose.", TRAJECTORY),
        MetricSpec("updates", "filter updates", "count", "Scans used to weight the particles."),
        MetricSpec(
            "converged.share",
            "time converged",
            "percent",
            "Share of the scans at which the particles had converged.",
        ),
    ),
)

PLAN = (
    section(
        "The path",
        "",
        MetricSpec("length_m", "length", "m", "Length of the planned path.", trusted=True),
        MetricSpec(
            "min_clearance_m",
            "minimum clearance",
            "cm",
            "Smallest distance from the footprint to an occupied or unknown cell.",
        ),
        MetricSpec("poses", "poses", "count", "Poses of the path."),
        sources=("path.csv",),
    ),
)

SECTIONS: dict[str, tuple[Section, ...]] = {
    "record": RECORD,
    "map": MAP,
    "localise": LOCALISE,
    "plan": PLAN,
    "navigate": RUN,
}
SPECS: dict[str, tuple[MetricSpec, ...]] = {
    kind: tuple(spec for section in sections for spec in section.specs) for kind, sections in SECTIONS.items()
}
GOAL_SOURCES = (*LOG, *BAG)
GOAL_NUMBERS = (
    MetricSpec("time_s", "time", "s", "Simulated time from the start of the goal to its end."),
    MetricSpec(
        "error_m",
        "true error",
        "cm",
        "Distance from the robot's true position to the goal when the goal checker accepted it.",
    ),
    MetricSpec("error_rad", "heading error", "deg", "The same for the heading."),
)
"""Of each goal of a run."""

# Inputs of the stage that a number is measured against.
REFERENCES = {
    "ate_m": ("truth",),
    "ate_aligned_m": ("truth",),
    "rpe": ("truth",),
    "map": ("truth",),
    "relations": ("relations",),
    "relations_cartographer": ("relations",),
}

# What each picture of a stage is drawn from, by the end of its name; a record's truth goes without saying.
PICTURE_SOURCES = {
    "record-drive": ("bag/", "truth/"),
    "map-error": MAP_FILES,
    "map-paths": TRAJECTORY,
    "map-map": (*MAP_FILES, *TRAJECTORY),
    "map-time": TRAJECTORY,
    "map-graph": GRAPH,
    "map-animation": (*TRAJECTORY, *MAP_FILES),
    "localise-path": TRAJECTORY,
    "localise-error": TRAJECTORY,
    "plan-path": ("path.csv", "path-*"),
    "navigate-path": (*LOG, *TRAJECTORY, "metrics.json"),
    "navigate-localisation": (*TRAJECTORY, *LOG),
    "navigate-clearance": LOG,
    "navigate-tight": LOG,
    "navigate-map": (*MAP_FILES, "truth/"),
    "navigate-particles": BAG,
    "navigate-animation": (*LOG, *BAG),
}
