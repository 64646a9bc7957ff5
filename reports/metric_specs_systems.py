"""The numbers of systems side by side, and the evo command that prints each."""

from __future__ import annotations

from dataclasses import replace

from turtlebag.reports.metric_spec import MetricSpec, Section, section
from turtlebag.reports.metric_specs_map import MAP

_OF_MAPS = {spec.path: spec for part in MAP for spec in part.specs}


def shared(path: str, meaning: str = "") -> MetricSpec:
    """A number that reports of maps show too, under the same name; what it means may be said otherwise."""
    spec = _OF_MAPS[path]
    return replace(spec, meaning=meaning or spec.meaning, sources=())


SYSTEMS: tuple[Section, ...] = (
    section(
        "The path",
        "Distance to {reference} at the same instants. The fit moves and turns each path as a whole: two "
        "systems rarely share a frame.{apart}",
        MetricSpec(
            "ate_aligned_m.rmse",
            "ATE after a fit in the plane, RMSE",
            "cm",
            "Root mean square distance after the best rigid fit of x and y.",
            trusted=True,
        ),
        MetricSpec("ate_aligned_m.max", "the same, largest", "cm", "The largest of these distances."),
        MetricSpec(
            "ours_there.ate_aligned_m.rmse",
            "TurtleBag over the same part, RMSE",
            "cm",
            "TurtleBag's first number over the part of the drive for which this system has poses.",
        ),
        MetricSpec(
            "ate_aligned_3d_m.rmse",
            "ATE after a fit in space, RMSE",
            "cm",
            "The same with height: the fit is in space (Umeyama's SE(3)).",
        ),
        MetricSpec(
            "ate_m.rmse",
            "ATE without alignment, RMSE",
            "cm",
            "Without alignment: meaningful only if both start in the same frame.",
        ),
    ),
    section(
        "Drift",
        "Relative pose error. Compare numbers per frame only between systems of the same rate.",
        replace(
            shared("rpe.trans_m", "Over each metre of the reference's path, wherever it starts; RMSE."),
            trusted=True,
        ),
        shared("rpe.rot_rad"),
        MetricSpec(
            "rpe_metre.trans_m.rmse", "RPE, 1 m, RMSE", "cm", "Over pairs a metre of its own path apart."
        ),
        MetricSpec("rpe_metre.rot_deg.rmse", "RPE, 1 m, angle, RMSE", "deg1", "The same for the angle."),
        MetricSpec("rpe_frame.trans_m.rmse", "RPE, 1 frame, RMSE", "cm", "From each pose to the next."),
        MetricSpec("rpe_frame.rot_deg.rmse", "RPE, 1 frame, angle, RMSE", "deg1", "The same for the angle."),
    ),
    section(
        "Hand-made relations",
        "Relative poses of some pairs of scans, verified by hand. A system that misses some of the drive is "
        "judged by fewer of them.",
        shared("relations.n", "Those with poses at both ends."),
        shared("relations.trans_m.mean"),
        shared("relations.trans_m.std", "Its deviation."),
        shared("relations.rot_deg.mean"),
        shared("relations_cartographer.trans_m.mean"),
    ),
    section(
        "Walls",
        "Against {map_reference}, each map after the best rigid alignment.",
        shared(
            "map.occupied_error_m.within_one_cell",
            "Occupied cells on or beside one of the other map: no invented walls.",
        ),
        shared(
            "map.coverage",
            "Surfaces of the other map with an occupied cell on or beside them: no missing walls.",
        ),
        shared("map.occupied_error_m.mean", "Distance to the nearest surface."),
        shared("map.occupied_error_m.p95", "95 % are no farther off."),
        shared("map.iou_one_cell", "Both shares in one number."),
    ),
    section(
        "Data compared",
        "",
        MetricSpec("poses", "poses", "count", "Poses in the file, repeated stamps left out."),
        MetricSpec("paired", "poses compared", "count", "Poses at the same instant as one of the reference."),
        MetricSpec("coverage", "share of the drive", "percent", "Time in which the system has poses."),
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
"""What prints a number as its rmse, of the two files of a system in `systems/`."""
NOT_JUDGED = ("poses", "paired", "coverage", "relations.n", "ours_there.ate_aligned_m.rmse")
