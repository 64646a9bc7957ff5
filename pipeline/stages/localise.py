"""The localise stage: a recording and a map in, where the robot was on that map out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import metrics_of
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.lidars import of_each_lidar
from turtlebag.datasets.maps import load_map, map_files
from turtlebag.datasets.motion import sweeps
from turtlebag.datasets.outputs import Output, Stopwatch
from turtlebag.datasets.parts import source_files
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.trajectories import load_tum, save_covariances, save_tum
from turtlebag.datasets.types import MountedLidar, Recording, Trajectory
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.localisation.localiser import Localiser
from turtlebag.pipeline.localisation.localisers import LocaliserName, make_localiser
from turtlebag.pipeline.localisation.nav2_yaml import is_nav2, read_nav2
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.navigation.initial_pose import require_on_map
from turtlebag.pipeline.slam.sensors.corrected import delay_metrics, in_agreement
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest
from turtlebag.pipeline.stages.requests.options import chosen_settings
from turtlebag.pipeline.stages.settings import Chosen, ConfigSource, load_config, settings_of
from turtlebag.pipeline.stages.sources import pose_or_word, recording_of
from turtlebag.pipeline.terminal.messages import length, log, log_notes, track
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.reports.metrics.navigation import localisation_errors
from turtlebag.reports.metrics.references import truth_folder


class LocaliseConfig(Settings, allow_inf_nan=False):
    """Settings of the stage."""

    localiser: LocaliserName = "amcl"
    amcl: AmclConfig = AmclConfig()


@dataclass(frozen=True, eq=False)
class Localisation:
    """What the filter said while the recording went by.

    `trajectory` has one pose a scan, each as known at that scan (never corrected afterwards), `covariance`
    (n, 3, 3) that of each on the map; `converged`, `updated` (n,) bool and `particles` (n,) say how the
    filter stood then.
    """

    trajectory: Trajectory
    covariance: np.ndarray
    converged: np.ndarray
    updated: np.ndarray
    particles: np.ndarray
    update_s: np.ndarray
    agreement: float
    """How much of the last scans the map explains, 0 to 1."""
    doubt: str | None
    """Why the last pose is not to be believed; None when it is."""


def localise(request: LocaliseRequest, out: Output) -> int:
    """Run AMCL over a recording and write the outputs; 0 localised, 1 lost at the end or rejected.

    With a truth, 0 needs `true_success` of the metrics: at the end the robot is where the filter believes.
    """
    config = load_localise_config(request.config, request.settings)
    grid, initial_pose = load_map(request.map), pose_or_word(request.initial_pose)
    if isinstance(initial_pose, SE2):
        require_on_map("--initial-pose", initial_pose, costmap_from_grid(grid, CostmapConfig()), request.map)
    recording = aligned_in_time(recording_of(request))
    truth = None if request.truth is None else truth_folder(request.truth)
    true_trajectory = None if truth is None else load_tum(truth / "trajectory.tum")
    odometry = checked_odometry(recording)
    if initial_pose is None:
        result, reason = None, "no initial pose"
        log.error("rejected: %s", reason)
        outcome = {"success": False, "status": "rejected", "reason": reason, "localisation_error_m": None}
    else:
        result = run_amcl(recording, grid, initial_pose, config, stream(request.seed, "amcl"))
        try:
            outcome = _metrics(result, true_trajectory)
        except ValueError as error:
            raise InputError(f"--truth {truth}: {error}") from None
    log_notes(recording.notes)
    metrics = {"scans": len(recording), "log_s": recording.duration(), **delay_metrics(recording), **outcome}
    metrics |= metrics_of(recording.findings)
    with out.staged() as folder:
        # Without an estimate the odometry stands in, as in a run without a map.
        save_tum(result.trajectory if result else odometry, folder / "trajectory.tum")
        if result is not None:
            save_covariances(result.trajectory, result.covariance, folder)
        parts: dict[str, str | None] = {"localiser": config.localiser}
        inputs = {"bag": request.source, **map_files(request.map), **source_files(parts)}
        inputs |= {"truth": truth} if truth else {}
        extra: dict[str, object] = {"parts": parts}
        if result is not None:
            times = 1e3 * result.update_s[result.updated]
            median, p95 = float(np.median(times)), float(np.percentile(times, 95))
            extra["update_ms"] = {"median": round(median, 3), "p95": round(p95, 3)}
        out.finish(
            folder, "localise", inputs, metrics=metrics, config=config_text(config), seed=request.seed,
            extra=extra,
        )  # fmt: skip
    if result is not None:
        _summarise(metrics, out.folder)
    return 0 if metrics.get("true_success", metrics["success"]) else 1


def aligned_in_time(recording: Recording) -> Recording:
    """The recording with scans and odometry of the same time, and each lidar facing as it does."""
    return of_each_lidar(recording, lambda part: in_agreement(part) or part)


def _summarise(metrics: dict[str, Any], out: Path) -> None:
    error, status = metrics["localisation_error_m"], metrics["status"]
    if metrics["success"] and not metrics.get("true_success", True):
        status = f"not localised: {length(metrics['last_error_m'])} off at the end"
    known = f", {length(error['rmse'])} RMSE from the truth" if error else ""
    reason = f" ({metrics['reason']})" if "reason" in metrics else ""
    log.info(
        f"{status}{reason}: {metrics['scans']} scans in {metrics['log_s']:.1f} s, "
        f"the map explains {metrics['agreement']:.0%} of the latest ones{known} -> {out}"
    )


def checked_odometry(recording: Recording) -> Trajectory:
    """Odometry at each scan; InputError when the recording has none or it is not finite."""
    T_odom_base = recording.T_odom_base
    if T_odom_base is None:
        raise InputError(f"{recording.source}: has no odometry, which localisation needs")
    if len(recording) == 0:
        raise InputError(f"{recording.source}: has no scans")
    bad = np.flatnonzero(~np.isfinite(T_odom_base.xyt).all(axis=1))
    if len(bad):
        raise InputError(f"{recording.source}: odometry of scan {bad[0]} is not finite")
    return Trajectory(recording.stamps_ns, T_odom_base)


def run_amcl(
    recording: Recording,
    grid: OccupancyGrid,
    initial_pose: SE2 | str,
    config: LocaliseConfig,
    rng: np.random.Generator,
) -> Localisation:
    """The filter over all scans in file order."""
    T_odom_base = checked_odometry(recording).poses
    T_odom_base_end = sweep_ends(recording)
    amcl = started(grid, recording.lidars, initial_pose, config, rng)
    poses, covariance, converged, updated, particles, update_s = [], [], [], [], [], []
    for i in track(range(len(recording)), "localising"):
        watch = Stopwatch()
        end = None if T_odom_base_end is None else T_odom_base_end[i]
        updated.append(amcl.update(recording.scan(i), T_odom_base[i], end))
        update_s.append(watch.seconds())
        poses.append(amcl.T_map_odom @ T_odom_base[i])
        covariance.append(amcl.covariance)
        converged.append(amcl.converged)
        particles.append(len(amcl.particles))
    return Localisation(
        Trajectory(recording.stamps_ns, SE2.stack(poses)),
        np.array(covariance),
        np.array(converged),
        np.array(updated),
        np.array(particles),
        np.array(update_s),
        amcl.agreement,
        doubt(amcl),
    )


def doubt(amcl: Localiser) -> str | None:
    """Why the filter's pose is not to be believed now; None when it is."""
    if not amcl.agrees:
        return "the last scans disagree with the map"
    return None if amcl.converged else "the particles have not converged"


def started(
    grid: OccupancyGrid,
    lidars: Sequence[MountedLidar],
    initial_pose: SE2 | str,
    config: LocaliseConfig,
    rng: np.random.Generator,
) -> Localiser:
    """The filter with its first cloud; InputError when the map has nothing to localise on."""
    try:
        first, *others = lidars
        parts = grid, first.spec, first.T_base_lidar, config.amcl, rng
        amcl = make_localiser(config.localiser, *parts, others)
        if isinstance(initial_pose, SE2):
            amcl.initialise(initial_pose)
        else:
            amcl.initialise_globally()
    except ValueError as error:
        raise InputError(f"cannot localise: {error}") from None
    return amcl


def sweep_ends(recording: Recording) -> SE2 | None:
    """Odometry at the end of each sweep, (n_scans,); None for a lidar that does not turn."""
    odometry, lidars = recording.odometry, [lidar.spec for lidar in recording.lidars]
    if not sweeps(recording) or odometry is None or np.any(np.diff(odometry.stamps_ns) <= 0):
        return None
    taken_ns = np.array([round(one.n_beams * abs(one.time_increment) * 1e9) for one in lidars])
    return odometry.at(recording.stamps_ns + taken_ns[recording.lidar_of])


def load_localise_config(source: ConfigSource, settings: Chosen) -> LocaliseConfig:
    """Ours, or the amcl part of a Nav2 parameter file (what it ignores is logged)."""
    data, where = settings_of(source), str(source) if isinstance(source, Path) else "config"
    if not data or not is_nav2(data):
        return load_config(LocaliseConfig, source, settings)
    known, ignored = read_nav2(data, where=where)
    if ignored:
        log.info("%s: ignored %s", where, ", ".join(ignored))
    told = {f"amcl.{name}": value for name, value in known.items()}
    return load_config(LocaliseConfig, None, told | chosen_settings(settings))


def _metrics(result: Localisation, truth: Trajectory | None) -> dict[str, Any]:
    first = int(np.argmax(result.converged)) if result.converged.any() else None
    stamps = result.trajectory.stamps_ns
    metrics: dict[str, Any] = {
        "success": result.doubt is None,
        "status": "localised" if result.doubt is None else "lost",
        **({} if result.doubt is None else {"reason": result.doubt}),
        "agreement": result.agreement,
        "updates": int(result.updated.sum()),
        "particles": {"median": float(np.median(result.particles)), "max": int(result.particles.max())},
        "converged": {
            "first_s": None if first is None else seconds(int(stamps[first] - stamps[0])),
            "share": float(result.converged.mean()),
        },
        "localisation_error_m": None,
    }
    if truth is not None:
        metrics |= localisation_errors(result.trajectory, truth, metrics["success"])
    return metrics
