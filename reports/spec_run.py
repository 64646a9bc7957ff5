"""The numbers of a run: what the robot believed and what was true, its contacts, its estimate."""

from __future__ import annotations

from turtlebag.reports.spec import BAG, LOG, SEEN, TRUTH, Section, Spec
from turtlebag.reports.spec_map import WALLS

RUN = (
    Section(
        "What it did",
        "Contacts and clearance come from the simulator, in the run log: a bag holds neither.",
        (
            Spec(
                "true_success",
                "success, by the truth",
                "yes",
                "No collision, and the robot was within 25 cm of every goal when it took it to be reached.",
                (*LOG, *BAG),
                TRUTH,
                trusted=True,
            ),
            Spec(
                "success",
                "success, as the robot believed",
                "yes",
                "No collision, and the goal checker, which only knows the robot's own estimate, accepted "
                "every goal in time.",
                LOG,
            ),
            Spec(
                "goals_truly_reached",
                "goals reached",
                "count",
                "Goals the robot was within 25 cm of when it took them to be reached.",
                (*LOG, *BAG),
                TRUTH,
            ),
            Spec(
                "goals_reached",
                "goals believed reached",
                "count",
                "Goals the goal checker accepted in time, on the robot's own estimate.",
                LOG,
            ),
            Spec(
                "goal_error_m.mean",
                "distance from the goals, mean",
                "cm",
                "Distance of the robot's true position from a goal when it took that goal to be reached.",
                BAG,
                TRUTH,
            ),
            Spec(
                "goal_error_m.max",
                "distance from the goals, largest",
                "cm",
                "The same, at the worst of the goals.",
                BAG,
                TRUTH,
            ),
            Spec(
                "collisions.visible",
                "collisions with visible things",
                "count",
                "Episodes of contact with something that crosses the lidar plane, from the run log.",
                LOG,
            ),
            Spec(
                "collisions.low",
                "contacts with low things",
                "count",
                "Episodes of contact with something below the lidar plane, which no lidar sees, from the run "
                "log.",
                LOG,
            ),
            Spec(
                "min_clearance_m",
                "least clearance",
                "cm",
                "Footprint to the nearest surface up to the robot's height, at the worst moment, from the "
                "run log; verify checks that the true path on the true map leaves no less room than that.",
                LOG,
            ),
            Spec("time_s", "time", "s", "Simulated time of the run.", BAG, TRUTH),
            Spec(
                "takeovers.count",
                "takeovers",
                "count",
                "How many times someone took over from navigation.",
                LOG,
                seldom=True,
            ),
            Spec(
                "takeovers.time_s",
                "time taken over",
                "s",
                "Simulated time that someone other than navigation drove.",
                LOG,
                seldom=True,
            ),
            Spec("distance_m", "distance driven", "m", "Length of the true path.", BAG, TRUTH),
        ),
    ),
    Section(
        "The floor it saw",
        "For runs without a goal: how much of the world came into view.",
        (
            Spec(
                "area.share",
                "floor seen, of what can be seen",
                "percent",
                "Of the true free floor in line of sight from anywhere the robot can get to.",
                SEEN,
                trusted=True,
            ),
            Spec(
                "area.seen_m2",
                "floor seen",
                "m2",
                "True free floor in line of sight of the lidar, within its range, at one of the true poses.",
                SEEN,
            ),
        ),
    ),
    Section(
        "How well it knew where it was",
        "The robot's own estimate (AMCL on the map) against the truth, at each scan.",
        (
            Spec(
                "localisation_error_m.rmse",
                "localisation error, RMSE",
                "cm",
                "Distance between the estimate and the true position at the estimate's stamps.",
                ("trajectory.tum", "bag/"),
                TRUTH,
                trusted=True,
            ),
            Spec(
                "localisation_error_m.max",
                "localisation error, largest",
                "cm",
                "Largest of those distances.",
                ("trajectory.tum", "bag/"),
                TRUTH,
            ),
        ),
    ),
    WALLS,
)
