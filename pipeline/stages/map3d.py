"""Stage `map` for point clouds: a bag in, a 3D map and its slice out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.bags.clouds import load_clouds
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Stopwatch, staged_output, write_json, write_manifest
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.trajectories import save_tum_3d
from turtlebag.pipeline.slam.pose_graph import residuals, write_g2o
from turtlebag.pipeline.slam3d.cloud_map import save_ply
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, Slam3dResult, run_slam_3d
from turtlebag.pipeline.stages.map_references import References
from turtlebag.pipeline.stages.map_summary import summary, tell_map
from turtlebag.pipeline.stages.settings import config_text, load_config
from turtlebag.pipeline.terminal.messages import log_notes, track

WORST = 10


def build_map_3d(
    source: Path,
    topic: str | None,
    out: Path,
    references: References,
    config: Path | None,
    settings: Sequence[str],
    named: str | None,
    explain: bool,
    force: bool,
    command: Sequence[str],
    watch: Stopwatch,
) -> int:
    """Map the point clouds of `source` into the folder `out`; returns the exit code.

    Arguments as of `build_map`. InputError when anything given cannot be used.
    """
    resolved = load_config(Slam3dConfig, config, settings)
    recording = load_clouds(source, topic)
    result = run_slam_3d(recording, resolved, track)
    log_notes((*recording.notes, *result.setting.notes))
    slam_s = watch.seconds()
    with staged_output(out, force=force) as folder:
        for name in ("map", *([] if named is None else [named])):
            save_map(result.grid, folder, name)
        save_ply(folder / "map.ply", result.points)
        save_tum_3d(recording.stamps_ns, result.T_map_base, folder / "trajectory.tum")
        write_g2o(folder / "graph.g2o", result.T_map_keys, result.constraints)
        errors: dict[str, Any] = dict(references.errors(result.trajectory, result.grid))
        if "ate_m" in errors:
            errors["out_of_plane"] = _out_of_plane(result.T_map_base)
        cloud = {"points": len(result.points), "voxel_m": result.setting.voxel}
        metrics = {**summary(recording, result), "cloud": cloud, **errors}
        write_json(folder / "metrics.json", metrics)
        (folder / "config.yaml").write_text(config_text(resolved))
        write_json(folder / "graph.json", loop_record(result))
        if explain:
            write_json(folder / "explain.json", explanation(result))
        write_manifest(
            folder,
            stage="map",
            command=command,
            inputs={"source": source, **references.inputs},
            wall_s=watch.seconds(),
            extra={"slam_s": round(slam_s, 3), "scans_per_s": round(len(recording) / slam_s, 1)},
        )
    tell_map(metrics, out, slam_s)
    return 0


def _out_of_plane(T: Array) -> dict[str, float]:
    """How far the poses leave the plane of the simulator's floor, RMS: height [m] and tilt [rad]."""
    tilt = np.arccos(np.clip(T[:, 2, 2], -1.0, 1.0))
    return {"z_m": float(np.sqrt(np.mean(T[:, 2, 3] ** 2))), "tilt_rad": float(np.sqrt(np.mean(tilt**2)))}


def loop_record(result: Slam3dResult) -> dict[str, Any]:
    """Keys, and every loop candidate: how it was found, scores, verdict, what is left at the final poses."""
    T = result.T_map_keys
    loops = []
    for loop in result.loops:
        left = se3.log(se3.inverse(loop.T_j_i) @ se3.inverse(T[loop.j]) @ T[loop.i])
        loops.append(
            {
                "i": loop.i,
                "j": loop.j,
                "by": loop.by,
                "T_j_i": se3.log(loop.T_j_i),
                "fitness": loop.fitness,
                "overlap": loop.overlap,
                "rmse_m": loop.rmse,
                "verdict": loop.verdict,
                "residual_m": float(np.linalg.norm(left[3:])),
                "residual_rad": float(np.linalg.norm(left[:3])),
            }
        )
    return {"keys": result.keys, "loops": loops}


def explanation(result: Slam3dResult) -> dict[str, Any]:
    """The constraints that fit the final poses least, and how far loops and refinement moved the keys."""
    left = residuals(result.T_map_keys, result.constraints)
    information = np.array([c.information for c in result.constraints]).reshape(-1, 6, 6)
    squared = np.einsum("na,nab,nb->n", left, information, left)
    worst = np.argsort(-squared, kind="stable")[:WORST]
    moved = np.linalg.norm(result.T_map_keys[:, :3, 3] - result.track.T[result.keys][:, :3, 3], axis=1)
    return {
        "worst_edges": [
            {
                "i": result.constraints[k].i,
                "j": result.constraints[k].j,
                "kind": result.constraints[k].kind,
                "sigmas": float(np.sqrt(max(squared[k], 0.0))),
            }
            for k in worst.tolist()
        ],
        "front_end": {"mean_overlap": float(result.track.overlap[result.track.usable].mean())},
        "moved_by_graph_m": {"mean": float(moved.mean()), "max": float(moved.max())},
    }
