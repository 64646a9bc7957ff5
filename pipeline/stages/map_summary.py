"""What `map` writes and says of a map that needs no truth: how good it is, and where it lies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from turtlebag.datasets.findings import metrics_of
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.types import Recording, Recording3D, Trajectory
from turtlebag.pipeline.slam.sensors.corrected import delay_metrics
from turtlebag.pipeline.terminal.messages import length, log
from turtlebag.reports.numbers import lookup

if TYPE_CHECKING:
    from turtlebag.pipeline.slam.mapper import SlamResult
    from turtlebag.pipeline.slam3d.slam3d import Slam3dResult


@dataclass(frozen=True, eq=False)
class Mapped:
    """What the scans or the point clouds of an input came to.

    `record` is for graph.json, `write` adds the files that only maps of this kind have; `metrics` too, and
    `with_truth` where the truth is given. `before_loops` are the poses of the front end alone, where they are
    of one recording. `manifest` are entries for the manifest.
    """

    recording: Recording | Recording3D
    config: BaseModel
    result: SlamResult | Slam3dResult
    record: Mapping[str, object]
    write: Callable[[Path], None]
    metrics: Mapping[str, object] = field(default_factory=dict)
    with_truth: Mapping[str, object] = field(default_factory=dict)
    before_loops: Trajectory | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)


SHOWN = (".yaml", ".pgm", ".ply", ".tum")
"""What people open; the other files beside them are named in the documentation."""
WITHIN = "map.occupied_error_m.within_one_cell"
BAD_M, BAD_WALLS = 0.2, 0.8
"""A map is bad when the truth says, after a rigid fit, that a scan of it lies farther off, or that a smaller
share of its wall cells lies within one cell of a true surface."""


def tell_map(metrics: Mapping[str, Any], out: Path, seconds: float) -> bool:
    """The verdict, the errors where they are known and the files, in as many lines; False for a map that
    the truth denies.
    """
    check, denied = metrics["self_check"], denials(metrics)
    for reason in check["reasons"]:
        log.warning(f"doubtful map: {reason}")
    for line in map_lines(metrics, out, seconds):
        log.info(line)
    for reason in denied:
        log.warning(f"bad map: {reason}")
    if denied and check["verdict"] == "good":
        log.warning("the self-check found nothing wrong: does the ground truth belong to this recording?")
    return not denied


def denials(metrics: Mapping[str, Any]) -> list[str]:
    """Why a map is bad by the truth: its path, after a rigid fit, and its walls."""
    worst, within = lookup(metrics, "ate_aligned_m.max"), lookup(metrics, WITHIN)
    found = []
    if worst is not None and worst > BAD_M:
        found.append(f"a scan of it lies {length(worst)} off")
    if within is not None and within < BAD_WALLS:
        found.append(f"only {within:.1%} of its wall cells lie within one cell of a true surface")
    return found


def verdict_of(metrics: Mapping[str, Any]) -> str:
    """`bad` for a map that the truth denies, else the verdict of the self-check."""
    return "bad" if denials(metrics) else str(metrics["self_check"]["verdict"])


def map_lines(metrics: Mapping[str, Any], out: Path, seconds: float) -> Iterator[str]:
    """The lines of a map's metrics and of the folder it was written to."""
    loops = metrics["loops"]
    yield (
        f"{verdict_of(metrics)} map of {counted(metrics['scans'], 'scan')} "
        f"({counted(metrics['keyframes'], 'key scan')}, "
        f"{loops['accepted']} of {loops['proposed']} loop candidates accepted) in {seconds:.1f} s"
    )
    if metrics["self_check"]["revisits"] == 0:
        yield "no place was seen twice, so the self-check had nothing to compare"
    if said := lookup(metrics, "self_check.scale.said"):
        yield said
    if "range_error_m" in metrics:
        near, far = (f"{1e3 * off:+.0f} mm" for off in metrics["range_error_m"].values())
        yield f"the lidar's ranges are off by {near} at 1 m and {far} at 3 m, as the scans show; corrected"
    if "ate_m" in metrics:
        fitted = metrics.get("fitted")
        error = metrics["ate_m" if fitted is None else "ate_aligned_m"]
        after = "" if fitted is None else f" after a rigid fit: {fitted}"
        yield f"trajectory error (ATE): {length(error['rmse'])} RMSE, {length(error['max'])} at most{after}"
    if "map" in metrics:
        error = metrics["map"]["occupied_error_m"]
        within = error["within_one_cell"]
        if within is not None and error["mean"] is not None:
            yield f"wall error: {length(error['mean'])} on average, {within:.1%} of the cells within one cell"
    if "relations" in metrics:
        relations = metrics["relations"]
        yield (
            f"relations: {relations['n']}, {relations['trans_m']['mean']:.3f} m and "
            f"{relations['rot_deg']['mean']:.2f} degrees off on average"
        )
    names = sorted(path.name for path in out.iterdir() if path.suffix in SHOWN and path.stem != "config")
    yield f"{out}: {', '.join(names)}"


def summary(recording: Recording | Recording3D, result: SlamResult | Slam3dResult) -> Mapping[str, object]:
    """Metrics that need no reference, the same of planar maps and of maps in 3D."""
    return {
        "scans": len(recording),
        "keyframes": len(result.keys),
        "loops": loop_counts([loop.accepted for loop in result.loops]),
        "log_s": recording.duration(),
        **_lidars(recording, result),
        **delay_metrics(recording),
        **metrics_of(recording.findings),
        "self_check": result.check.as_metrics(),
    }


def _lidars(recording: Recording | Recording3D, result: SlamResult | Slam3dResult) -> dict[str, object]:
    """What each of several lidars contributed."""
    if isinstance(recording, Recording3D) or not recording.others:
        return {}
    session = cast("SlamResult", result).session
    scans, of_key = recording.lidar_of, recording.lidar_of[session.track.keys]
    errors = (session.ranges, *session.ranges.others)
    rows = [
        {
            "topic": lidar.topic,
            "scans": int(np.count_nonzero(scans == number)),
            "keyframes": int(np.count_nonzero(of_key == number)),
            **(errors[number].as_metrics() if number < len(errors) else {}),
        }
        for number, lidar in enumerate(recording.lidars)
    ]
    return {"lidars": rows}


def loop_counts(accepted: Sequence[bool] | NDArray[np.bool_]) -> dict[str, int]:
    """How many loops were proposed, and what became of them."""
    kept = sum(map(bool, accepted))
    return {"proposed": len(accepted), "accepted": kept, "rejected": len(accepted) - kept}
