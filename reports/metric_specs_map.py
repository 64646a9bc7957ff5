"""The numbers of a map: its walls, its path, and how it was made."""

from __future__ import annotations

from turtlebag.reports.metric_spec import GRAPH, MAP_FILES, TRAJECTORY, MetricSpec, section

WALLS = section(
    "Walls",
    "Judge a map by the two marked numbers: the first shows that no walls were invented, the "
    "second that none are missing. Use the others to compare maps on the same grid. Distances "
    "are between cell centres.",
    MetricSpec(
        "map.occupied_error_m.within_one_cell",
        "wall cells within one cell",
        "percent",
        "Occupied map cells that are, or touch, a true surface cell: no invented walls.",
        trusted=True,
    ),
    MetricSpec(
        "map.coverage",
        "surfaces found",
        "percent",
        "True visible surface cells with an occupied map cell on or beside them: no missing walls.",
        trusted=True,
    ),
    MetricSpec(
        "map.occupied_error_m.mean",
        "wall error, mean",
        "cm",
        "Distance from each occupied map cell to the nearest true surface cell a robot could see.",
    ),
    MetricSpec(
        "map.occupied_error_m.p95",
        "wall error, 95 %",
        "cm",
        "95 % of the cells are no farther off than this.",
    ),
    MetricSpec(
        "map.iou_one_cell",
        "map IoU, one cell tolerance",
        "percent",
        "Both marked shares in one number: matching cells over all cells of either map. A "
        "neighbouring cell counts as a match.",
    ),
    MetricSpec(
        "map.iou",
        "map IoU, no tolerance",
        "percent",
        "Occupied map cells against true visible surface cells, cell by cell. Walls are one cell "
        "thick, so a wall just across a cell border counts twice against the map, as missing and "
        "as invented; the true map shifted by half a cell scores below 20 %. Use it to compare "
        "maps on the same grid, not to judge one.",
    ),
    sources=MAP_FILES,
)
MAP = (
    WALLS,
    section(
        "The path",
        "Distance between the estimated and the true position at each scan.",
        MetricSpec(
            "ate_m.rmse",
            "trajectory error (ATE), RMSE",
            "cm",
            "Root mean square distance between SLAM and true positions at the scans, without alignment.",
            trusted=True,
        ),
        MetricSpec("ate_m.max", "trajectory error, largest", "cm", "The largest of these distances."),
        MetricSpec(
            "ate_aligned_m.rmse",
            "trajectory error after alignment, RMSE",
            "cm",
            "The same after the best rigid alignment: it measures the shape of the path, not its start.",
        ),
        MetricSpec(
            "rpe.trans_m",
            "drift per metre",
            "cm/m",
            "Relative pose error over each metre of true path, RMSE.",
        ),
        MetricSpec("rpe.rot_rad", "heading error per metre", "deg/m", "The same for the heading."),
        sources=TRAJECTORY,
    ),
    section(
        "Hand-made relations",
        "For public logs without truth: relative poses of some pairs of scans, verified by hand.",
        MetricSpec("relations.n", "relations", "count", "Hand-made pose relations used."),
        MetricSpec(
            "relations.trans_m.mean",
            "relations error, mean",
            "m4",
            "Translation error by metricEvaluator's definition (Kümmerle et al. 2009).",
            trusted=True,
        ),
        MetricSpec(
            "relations.trans_m.std",
            "relations error, standard deviation",
            "m4",
            "Standard deviation of that error over the relations.",
        ),
        MetricSpec(
            "relations.rot_deg.mean", "relations heading error, mean", "deg1", "Mean absolute yaw error."
        ),
        MetricSpec(
            "relations_cartographer.trans_m.mean",
            "relations error (Cartographer's), mean",
            "m4",
            "Norm of (p1^-1 p2) expected^-1.",
        ),
        sources=TRAJECTORY,
    ),
    section(
        "Self-check",
        "Consistency of the map without any truth: where the robot passed twice, the walls of "
        "both visits must agree.",
        MetricSpec(
            "self_check.revisits",
            "revisits compared",
            "count",
            "Pairs of key scans taken at the same place at different times.",
        ),
        MetricSpec(
            "self_check.mean_violation",
            "free-space violations",
            "percent",
            "Mean share of the wall points of one visit that lie where the other visit saw free "
            "space. High in a doubled or folded map.",
            trusted=True,
        ),
        MetricSpec(
            "self_check.bad_places",
            "contradicting revisits",
            "percent",
            "Revisits in which more than a third of the wall points lie in free space.",
        ),
        MetricSpec(
            "self_check.lost_scans", "unmatched scans", "count", "Scans that match nothing seen before them."
        ),
        MetricSpec(
            "self_check.position_sigma_m",
            "position uncertainty",
            "cm",
            "Standard deviation of the least certain key scan, by the covariance of the pose graph, after a "
            "rigid fit.",
        ),
    ),
    section(
        "Mapping",
        "",
        MetricSpec("scans", "scans", "count", "Scans with a pose.", TRAJECTORY),
        MetricSpec("log_s", "log", "s", "Time span of the scans.", TRAJECTORY),
        MetricSpec(
            "odometry_late_s",
            "odometry delay",
            "s",
            "Delay of the odometry behind the scans (negative: ahead), judged by the turns of both; "
            "corrected.",
        ),
        MetricSpec(
            "range_error_m.at_1_m",
            "range error at 1 m",
            "mm",
            "How much too long ranges were (negative: too short), estimated from the scans; corrected.",
        ),
        MetricSpec("range_error_m.at_3_m", "range error at 3 m", "mm", "The same, farther away."),
        MetricSpec("keyframes", "key scans", "count", "Scans that are nodes of the pose graph.", GRAPH[:1]),
        MetricSpec(
            "loops.proposed",
            "loops proposed",
            "count",
            "Loop closure candidates: places that look as if the robot had been there before.",
            GRAPH[1:],
        ),
        MetricSpec("loops.accepted", "loops accepted", "count", "Candidates kept in the graph.", GRAPH[1:]),
        MetricSpec(
            "loops.rejected", "loops rejected", "count", "Candidates that failed verification.", GRAPH[1:]
        ),
    ),
)
