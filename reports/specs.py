"""Which numbers a report shows of each stage, in which order and under which headings."""

from __future__ import annotations

from turtlebag.reports.spec import BAG, GRAPH, LOG, MAP_FILES, ODOMETRY, TRAJECTORY, TRUTH, Section, Spec
from turtlebag.reports.spec_map import MAP
from turtlebag.reports.spec_run import RUN

RECORD = (
    Section(
        "What was recorded",
        "",
        (
            Spec("scans", "scans", "count", "Lidar sweeps in the bag.", BAG, ("/scan",)),
            Spec(
                "duration_s",
                "duration",
                "s",
                "From the first scan to the last, simulated time.",
                BAG,
                ("/scan",),
            ),
            Spec("distance_m", "distance driven", "m", "Length of the true path.", BAG, TRUTH),
        ),
    ),
    Section(
        "How far off the wheels were",
        "Errors of the wheel odometry add up. These are what mapping has to put right.",
        (
            Spec(
                "odometry_ate_m.rmse",
                "odometry error, RMSE",
                "cm",
                "Wheel odometry against the truth at the scans, no alignment: both start at the same pose.",
                BAG,
                ODOMETRY,
            ),
            Spec(
                "odometry_ate_m.max",
                "odometry error, largest",
                "cm",
                "Largest distance between wheel odometry and truth.",
                BAG,
                ODOMETRY,
            ),
            Spec(
                "odometry_rpe.trans_m",
                "odometry drift per metre",
                "cm/m",
                "Relative pose error of the odometry over each metre of true path, RMSE.",
                BAG,
                ODOMETRY,
            ),
            Spec(
                "odometry_rpe.rot_rad",
                "odometry turn error per metre",
                "deg/m",
                "The same for the heading.",
                BAG,
                ODOMETRY,
            ),
        ),
    ),
)

LOCALISE = (
    Section(
        "Where it was",
        "",
        (
            Spec(
                "true_success",
                "localised, by the truth",
                "yes",
                "At the end the filter was settled and within 25 cm of the truth.",
                TRAJECTORY,
            ),
            Spec(
                "success",
                "localised, as the filter believed",
                "yes",
                "At the end the filter was settled and the scans agreed with the map.",
            ),
            Spec(
                "last_error_m",
                "error at the end",
                "cm",
                "Distance between the estimate and the true position at the last scan.",
                TRAJECTORY,
            ),
            Spec(
                "localisation_error_m.rmse",
                "localisation error, RMSE",
                "cm",
                "Distance between the estimate and the true position at the scans.",
                TRAJECTORY,
                trusted=True,
            ),
            Spec(
                "localisation_error_m.max",
                "localisation error, largest",
                "cm",
                "Largest of those.",
                TRAJECTORY,
            ),
            Spec(
                "localisation_error_rad.rmse",
                "heading error, RMSE",
                "deg",
                "The same for the heading.",
                TRAJECTORY,
            ),
        ),
    ),
    Section(
        "State of the filter",
        "",
        (
            Spec("scans", "scans", "count", "Scans with a pose.", TRAJECTORY),
            Spec("updates", "filter updates", "count", "Scans the filter weighed its particles with."),
            Spec(
                "converged.share",
                "time converged",
                "percent",
                "Share of the scans with one tight cloud of particles.",
            ),
        ),
    ),
)

PLAN = (
    Section(
        "The path",
        "",
        (
            Spec("length_m", "length", "m", "Length of the planned path.", ("path.csv",), trusted=True),
            Spec(
                "min_clearance_m",
                "least clearance",
                "cm",
                "Footprint to the nearest occupied or unknown cell, at the tightest pose.",
                ("path.csv",),
            ),
            Spec("poses", "poses", "count", "Poses of the path.", ("path.csv",)),
        ),
    ),
)

SECTIONS: dict[str, tuple[Section, ...]] = {
    "record": RECORD,
    "map": MAP,
    "localise": LOCALISE,
    "plan": PLAN,
    "navigate": RUN,
}
SPECS: dict[str, tuple[Spec, ...]] = {
    kind: tuple(spec for section in sections for spec in section.specs) for kind, sections in SECTIONS.items()
}
GOAL_SOURCES = (*LOG, *BAG)
GOAL_MEANINGS = {
    "time_s": "From being sent to the goal to being done with it, simulated time.",
    "error_m": "Distance of the robot's true place from the goal when its goal checker was satisfied.",
    "error_rad": "The same for the heading.",
}
PLANNER_UNITS = {"length_m": "m", "min_clearance_m": "cm", "poses": "count"}
GOAL_UNITS = {"time_s": "s", "error_m": "cm", "error_rad": "deg"}

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
