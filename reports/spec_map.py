"""The numbers of a map: its walls, its path, and how it was made."""

from __future__ import annotations

from turtlebag.reports.spec import GRAPH, MAP_FILES, TRAJECTORY, Section, Spec

WALLS = Section(
    "The walls",
    "Judge a map by the two marked numbers together: the first says that no wall was invented, the second "
    "that none is missing. The others are for comparing maps drawn on the same grid. Distances are between "
    "cell centres.",
    (
        Spec(
            "map.occupied_error_m.within_one_cell",
            "wall cells within one cell",
            "percent",
            "Occupied map cells that are, or touch, a true surface cell: no invented walls.",
            MAP_FILES,
            trusted=True,
        ),
        Spec(
            "map.coverage",
            "surfaces found",
            "percent",
            "True visible surface cells with an occupied map cell on or beside them: no missing walls.",
            MAP_FILES,
            trusted=True,
        ),
        Spec(
            "map.occupied_error_m.mean",
            "wall error, mean",
            "cm",
            "Distance from each occupied map cell to the nearest true surface cell a robot could see.",
            MAP_FILES,
        ),
        Spec(
            "map.occupied_error_m.p95",
            "wall error, 95 %",
            "cm",
            "95 of 100 cells are no further off than this.",
            MAP_FILES,
        ),
        Spec(
            "map.iou_one_cell",
            "map IoU, one cell tolerance",
            "percent",
            "The two marked shares in one number: cells that match, over all cells of either map, where "
            "a neighbour counts as a match.",
            MAP_FILES,
        ),
        Spec(
            "map.iou",
            "map IoU, no tolerance",
            "percent",
            "Occupied map cells against true visible surface cells, cell for cell. Walls are one cell thick: "
            "one that lies a hair beyond a cell's border counts twice against the map, as missing and as "
            "invented, and the true map itself, drawn half a cell beside, gets less than 20 %. To compare "
            "maps drawn on the same grid, not to judge one.",
            MAP_FILES,
        ),
    ),
)
MAP = (
    WALLS,
    Section(
        "The path",
        "How far the robot was from where the map says it was, at each scan.",
        (
            Spec(
                "ate_m.rmse",
                "trajectory error (ATE), RMSE",
                "cm",
                "Root mean square distance between SLAM and true positions at the scans, without alignment.",
                TRAJECTORY,
                trusted=True,
            ),
            Spec("ate_m.max", "trajectory error, largest", "cm", "Largest of those distances.", TRAJECTORY),
            Spec(
                "ate_aligned_m.rmse",
                "trajectory error after alignment, RMSE",
                "cm",
                "The same after the best rigid motion: the shape of the path, not where it starts.",
                TRAJECTORY,
            ),
            Spec(
                "rpe.trans_m",
                "drift per metre",
                "cm/m",
                "Relative pose error over each metre of true path, RMSE.",
                TRAJECTORY,
            ),
            Spec("rpe.rot_rad", "turn error per metre", "deg/m", "The same for the heading.", TRAJECTORY),
        ),
    ),
    Section(
        "Against hand-made relations",
        "For public logs without truth: people measured where some pairs of scans really were.",
        (
            Spec("relations.n", "relations", "count", "Hand-made pose relations used.", TRAJECTORY),
            Spec(
                "relations.trans_m.mean",
                "relations error, mean",
                "m4",
                "Translation error by metricEvaluator's definition (Kümmerle et al. 2009).",
                TRAJECTORY,
                trusted=True,
            ),
            Spec(
                "relations.trans_m.std",
                "relations error, standard deviation",
                "m4",
                "How much that error varies from relation to relation.",
                TRAJECTORY,
            ),
            Spec(
                "relations.rot_deg.mean",
                "relations turn error, mean",
                "deg1",
                "Its absolute yaw.",
                TRAJECTORY,
            ),
            Spec(
                "relations_cartographer.trans_m.mean",
                "relations error (Cartographer's), mean",
                "m4",
                "Norm of (p1^-1 p2) expected^-1.",
                TRAJECTORY,
            ),
        ),
    ),
    Section(
        "Its own check",
        "What the map says of itself, without any truth: wherever the robot came twice, the walls of both "
        "visits must agree.",
        (
            Spec(
                "self_check.revisits",
                "revisits compared",
                "count",
                "Pairs of key scans taken at one place at different times.",
            ),
            Spec(
                "self_check.denied_mean",
                "walls seen through",
                "percent",
                "Mean share of the wall points of one visit that the other visit saw through: a doubled or "
                "folded map has many.",
                trusted=True,
            ),
            Spec(
                "self_check.bad_places",
                "contradicting revisits",
                "percent",
                "Revisits in which more than a third of the wall points are seen through.",
            ),
            Spec(
                "self_check.lost_scans",
                "scans that fit nowhere",
                "count",
                "Scans that fitted nothing seen before them.",
            ),
        ),
    ),
    Section(
        "How it was made",
        "",
        (
            Spec("scans", "scans", "count", "Scans that got a pose.", TRAJECTORY),
            Spec("log_s", "log", "s", "Time span of the scans.", TRAJECTORY),
            Spec(
                "odometry_late_s",
                "delay of the odometry",
                "s",
                "How far it ran behind the scans (negative: ahead), by the turns of both; undone.",
            ),
            Spec("keyframes", "key scans", "count", "Scans that are nodes of the pose graph.", GRAPH[:1]),
            Spec(
                "loops.proposed",
                "loops proposed",
                "count",
                "Candidates for loop closures: places that looked as if the robot had been there before.",
                GRAPH[1:],
            ),
            Spec("loops.accepted", "loops accepted", "count", "Candidates kept in the graph.", GRAPH[1:]),
            Spec(
                "loops.rejected", "loops rejected", "count", "Candidates that failed verification.", GRAPH[1:]
            ),
        ),
    ),
)
