"""Stage `map` for point clouds: what a 3D map has of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.bags.point_clouds import load_clouds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import write_json
from turtlebag.datasets.trajectories import save_tum_3d
from turtlebag.pipeline.slam.explain import candidate, moved, worst_edges
from turtlebag.pipeline.slam3d.cloud_map import save_ply
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, Slam3dResult, run_slam_3d
from turtlebag.pipeline.stages.command_line import flag_of_field
from turtlebag.pipeline.stages.map_summary import Mapped
from turtlebag.pipeline.stages.requests.maps import MapRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.terminal.messages import log_notes, track

PLANAR = ("topic", "also", "laser", "continued", "edits")
"""Fields of a request that only planar scans can be mapped with, of topics more than one."""


def map_clouds(request: MapRequest) -> Mapped:
    """Map the point clouds of a bag; InputError when anything given cannot be used."""
    for name in PLANAR:
        if getattr(request, name) and not (name == "topic" and len(request.topic) == 1):
            option, source = flag_of_field(request, name), request.source
            raise InputError(f"{option}: for 2D scans only, but {source} is mapped in 3D")
    resolved = load_config(Slam3dConfig, request.config, request.settings)
    recording = load_clouds(request.source, next(iter(request.topic), None))
    result = run_slam_3d(recording, resolved, track)
    log_notes((*recording.notes, *result.setup.notes))

    def write(folder: Path) -> None:
        save_ply(folder / "map.ply", result.points)
        save_tum_3d(recording.stamps_ns, result.T_map_base, folder / "trajectory.tum")
        if request.explain:
            write_json(folder / "explain.json", explanation(result))

    T = result.T_map_keys
    record = {
        "keys": result.keys,
        "loops": [candidate(loop, T) for loop in result.loops],
        "recognised": [candidate(loop, T) for loop in result.recognised],
    }
    cloud = {"points": len(result.points), "voxel_m": result.setup.voxel}
    # How far the poses leave the plane of the simulator's floor.
    z, cosine = result.T_map_base[:, 2, 3], result.T_map_base[:, 2, 2]
    tilt = np.arccos(np.clip(cosine, -1.0, 1.0))
    rms = {"z_m": float(np.sqrt(np.mean(z**2))), "tilt_rad": float(np.sqrt(np.mean(tilt**2)))}
    return Mapped(recording, resolved, result, record, write, {"cloud": cloud}, {"out_of_plane": rms})


def explanation(result: Slam3dResult) -> dict[str, Any]:
    """The constraints that fit the final poses least, and how far loops and refinement moved the keys."""
    shifts = (result.T_map_keys.matrix - result.track.T[result.keys])[:, :3, 3]
    return {
        "worst_edges": worst_edges(result.T_map_keys, result.constraints),
        "front_end": {"mean_overlap": float(result.track.overlap[result.track.usable].mean())},
        "moved_by_graph_m": moved(shifts),
    }
