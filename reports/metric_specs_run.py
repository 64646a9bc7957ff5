"""The numbers of a run: what the robot believed and what was true, its contacts, its estimate."""

from __future__ import annotations

from turtlebag.reports.metric_spec import BAG, LOG, SEEN, TRUTH, MetricSpec, section
from turtlebag.reports.metric_specs_map import WALLS

LARGEST_ERROR = MetricSpec(
    "localisation_error_m.max", "localisation error, largest", "cm", "The largest of these distances."
)
RUN = (
    section(
        "Outcome",
        "Contacts and clearance come from the simulator through the run log; a bag holds neither.",
        MetricSpec(
            "true_success",
            "success (ground truth)",
            "yes",
            "No collision, and the robot was within 25 cm of every goal when it reported the goal as "
            "reached.",
            (*LOG, *BAG),
            TRUTH,
            trusted=True,
        ),
        MetricSpec(
            "success",
            "success (robot's estimate)",
            "yes",
            "No collision, and the goal checker, which knows only the robot's estimate, accepted "
            "every goal in time.",
            LOG,
        ),
        MetricSpec(
            "goals_truly_reached",
            "goals reached",
            "count",
            "Goals that the robot was within 25 cm of when it reported them as reached.",
            (*LOG, *BAG),
            TRUTH,
        ),
        MetricSpec(
            "goals_reached",
            "goals reported as reached",
            "count",
            "Goals that the goal checker accepted in time, based on the robot's estimate.",
            LOG,
        ),
        MetricSpec(
            "goal_error_m.mean",
            "distance from the goals, mean",
            "cm",
            "Distance from the robot's true position to a goal when it reported the goal as reached.",
            BAG,
            TRUTH,
        ),
        MetricSpec(
            "goal_error_m.max",
            "distance from the goals, largest",
            "cm",
            "The same for the worst goal.",
            BAG,
            TRUTH,
        ),
        MetricSpec(
            "collisions.visible",
            "visible collisions",
            "count",
            "Episodes of contact with an object that crosses the lidar plane, from the run log.",
            LOG,
        ),
        MetricSpec(
            "collisions.low",
            "low collisions",
            "count",
            "Episodes of contact with an object below the lidar plane, which the lidar cannot see, "
            "from the run log.",
            LOG,
        ),
        MetricSpec(
            "min_clearance_m",
            "minimum clearance",
            "cm",
            "Smallest distance from the footprint to a surface up to the robot's height, from the run "
            "log. verify checks that the true path on the true map leaves at least as much room.",
            LOG,
        ),
        MetricSpec("time_s", "time", "s", "Simulated time of the run.", BAG, TRUTH),
        MetricSpec(
            "overrides.count",
            "teleop overrides",
            "count",
            "Times that teleoperation overrode navigation.",
            LOG,
            seldom=True,
        ),
        MetricSpec(
            "overrides.time_s",
            "time under teleop",
            "s",
            "Simulated time during which teleoperation drove the robot.",
            LOG,
            seldom=True,
        ),
        MetricSpec("distance_m", "distance driven", "m", "Length of the true path.", BAG, TRUTH),
    ),
    section(
        "Floor seen",
        "For runs without a goal: how much of the world the lidar saw.",
        MetricSpec(
            "area.share",
            "floor seen, share",
            "percent",
            "Floor seen, as a share of all free floor that can be seen from anywhere the robot can reach.",
            trusted=True,
        ),
        MetricSpec(
            "area.seen_m2",
            "floor seen",
            "m2",
            "True free floor within the lidar's range and line of sight at some true pose.",
        ),
        sources=SEEN,
    ),
    section(
        "Localisation",
        "The robot's estimate (AMCL on the map) against the truth at each scan.",
        MetricSpec(
            "localisation_error_m.rmse",
            "localisation error, RMSE",
            "cm",
            "Distance between the estimate and the true position at the estimate's stamps.",
            trusted=True,
        ),
        LARGEST_ERROR,
        sources=("trajectory.tum", "bag/"),
        topics=TRUTH,
    ),
    WALLS,
)
