"""Stage `map` for point clouds: what a 3D map has of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.bags.point_clouds import load_clouds
from turtlebag.datasets.outputs import write_json
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.trajectories import save_tum_3d
from turtlebag.pipeline.slam.explain import candidate, moved, worst_edges
from turtlebag.pipeline.slam3d.cloud_map import save_ply
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, Slam3dResult, run_slam_3d
from turtlebag.pipeline.stages.map_summary import Mapped
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.terminal.messages import log_notes, track


def map_clouds(
    source: Path, topic: str | None, config: Path | None, settings: Sequence[str], *, explain: bool
) -> Mapped:
    """Map the point clouds of a bag; InputError when anything given cannot be used."""
    resolved = load_config(Slam3dConfig, config, settings)
    recording = load_clouds(source, topic)
    result = run_slam_3d(recording, resolved, track)
    log_notes((*recording.notes, *result.setup.notes))

    def write(folder: Path) -> None:
        save_ply(folder / "map.ply", result.points)
        save_tum_3d(recording.stamps_ns, result.T_map_base, folder / "trajectory.tum")
        if explain:
            write_json(folder / "explain.json", explanation(result))

    T = result.T_map_keys
    record = {
        "keys": result.keys,
        "loops": [candidate(loop, T) for loop in result.loops],
        "recognised": [candidate(loop, T) for loop in result.recognised],
    }
    cloud = {"points": len(result.points), "voxel_m": result.setup.voxel}
    out_of_plane = {"out_of_plane": _out_of_plane(result.T_map_base)}
    return Mapped(recording, resolved, result, record, write, {"cloud": cloud}, out_of_plane)


def _out_of_plane(T: Array) -> dict[str, float]:
    """How far the poses leave the plane of the simulator's floor, RMS: height [m] and tilt [rad]."""
    tilt = np.arccos(np.clip(T[:, 2, 2], -1.0, 1.0))
    return {"z_m": float(np.sqrt(np.mean(T[:, 2, 3] ** 2))), "tilt_rad": float(np.sqrt(np.mean(tilt**2)))}


def explanation(result: Slam3dResult) -> dict[str, Any]:
    """The constraints that fit the final poses least, and how far loops and refinement moved the keys."""
    shifts = (result.T_map_keys - result.track.T[result.keys])[:, :3, 3]
    return {
        "worst_edges": worst_edges(result.T_map_keys, result.constraints),
        "front_end": {"mean_overlap": float(result.track.overlap[result.track.usable].mean())},
        "moved_by_graph_m": moved(shifts),
    }
