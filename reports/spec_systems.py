"""The numbers of systems side by side, and the evo command that prints each."""

from __future__ import annotations

from turtlebag.reports.spec import Section, Spec, section

SYSTEMS: tuple[Section, ...] = (
    section(
        "The path",
        "Distance to {reference} at the same instants. The fit moves and turns each path as a whole: two "
        "systems seldom share a frame.{apart}",
        Spec(
            "ate_aligned_m.rmse",
            "ATE after a fit in the plane, RMSE",
            "cm",
            "Root mean square distance after the best rigid fit of x and y.",
            trusted=True,
        ),
        Spec("ate_aligned_m.max", "the same, largest", "cm", "The largest of these distances."),
        Spec(
            "ours_there.ate_aligned_m.rmse",
            "TurtleBag over the same part, RMSE",
            "cm",
            "The first number of TurtleBag where this system, which misses some of the drive, has poses.",
        ),
        Spec(
            "ate_aligned_3d_m.rmse",
            "ATE after a fit in space, RMSE",
            "cm",
            "The same with height: the fit is in space (Umeyama's SE(3)).",
        ),
        Spec(
            "ate_m.rmse", "ATE as it is, RMSE", "cm", "Without a fit: of use where both began in one frame."
        ),
    ),
    section(
        "Drift",
        "Relative pose error. Numbers per frame compare only systems of one rate.",
        Spec(
            "rpe.trans_m",
            "drift per metre",
            "cm/m",
            "Over each metre of the reference's path, wherever it starts; RMSE.",
            trusted=True,
        ),
        Spec("rpe.rot_rad", "heading error per metre", "deg/m", "The same for the heading."),
        Spec("rpe_metre.trans_m.rmse", "RPE, 1 m, RMSE", "cm", "Over pairs a metre of its own path apart."),
        Spec("rpe_metre.rot_deg.rmse", "RPE, 1 m, angle, RMSE", "deg1", "The same for the angle."),
        Spec("rpe_frame.trans_m.rmse", "RPE, 1 frame, RMSE", "cm", "From each pose to the next."),
        Spec("rpe_frame.rot_deg.rmse", "RPE, 1 frame, angle, RMSE", "deg1", "The same for the angle."),
    ),
    section(
        "Hand-made relations",
        "Relative poses of some pairs of scans, verified by hand.",
        Spec("relations.n", "relations", "count", "Those with poses at both ends."),
        Spec(
            "relations.trans_m.mean",
            "relations error, mean",
            "m4",
            "Translation error by metricEvaluator's definition (Kümmerle et al. 2009).",
            trusted=True,
        ),
        Spec("relations.trans_m.std", "relations error, standard deviation", "m4", "Its deviation."),
        Spec("relations.rot_deg.mean", "relations heading error, mean", "deg1", "Mean absolute yaw error."),
        Spec(
            "relations_cartographer.trans_m.mean",
            "relations error (Cartographer's), mean",
            "m4",
            "Norm of (p1^-1 p2) expected^-1.",
        ),
    ),
    section(
        "Walls",
        "Against {map_reference}, each map laid on it as well as it can be.",
        Spec(
            "map.occupied_error_m.within_one_cell",
            "wall cells within one cell",
            "percent",
            "Occupied cells on or beside one of the other map: no invented walls.",
            trusted=True,
        ),
        Spec(
            "map.coverage",
            "surfaces found",
            "percent",
            "Surfaces of the other map with an occupied cell on or beside them: no missing walls.",
            trusted=True,
        ),
        Spec("map.occupied_error_m.mean", "wall error, mean", "cm", "Distance to the nearest surface."),
        Spec("map.occupied_error_m.p95", "wall error, 95 %", "cm", "95 % are no farther off."),
        Spec("map.iou_one_cell", "map IoU, one cell tolerance", "percent", "Both shares in one number."),
    ),
    section(
        "What there was to measure",
        "",
        Spec("poses", "poses", "count", "Poses in the file, repeated stamps left out."),
        Spec("paired", "poses compared", "count", "Poses at the same instant as one of the reference."),
        Spec("coverage", "share of the drive", "percent", "Time in which the system has poses."),
    ),
)

EVO = {
    "ate_m.rmse": "evo_ape",
    "ate_aligned_3d_m.rmse": "evo_ape -a",
    "rpe_metre.trans_m.rmse": "evo_rpe -d 1 -u m",
    "rpe_metre.rot_deg.rmse": "evo_rpe -d 1 -u m -r angle_deg",
    "rpe_frame.trans_m.rmse": "evo_rpe -d 1 -u f",
    "rpe_frame.rot_deg.rmse": "evo_rpe -d 1 -u f -r angle_deg",
}
"""What prints a number as its rmse, of the two files of a system in `rivals/`."""
MORE_IS_BETTER = ("within_one_cell", "coverage", "iou_one_cell")
NOT_JUDGED = ("poses", "paired", "coverage", "relations.n", "ours_there.ate_aligned_m.rmse")
