"""What a drive looks like, real or simulated: samples of many quantities, each the same way for both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from turtlebag.datasets.grid import FREE, OCCUPIED_FROM, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.pipeline.identify.lidar import walls_of
from turtlebag.pipeline.slam.mapper import SlamResult

# Ways [m] and the turn [rad] over which odometry is compared with the map's path.
WAYS_M, TURN_RAD = (1.0, 5.0, 20.0), np.pi
# Ranges are looked at apart up to these [m]; the side of a part of a map [m].
NEAR_M, TILE_M = (1.0, 2.5), 2.0
# Key scans are counted over so much way [m].
STRETCH_M = 5.0
# A return this near a wall of the map [m] is explained by it.
EXPLAINED_M = 0.1
# Cells of a part of a map that must be known.
LEAST_CELLS = 50
# Values of scans nearer in time than this [s] say the same.
APART_S = 2.0


@dataclass(frozen=True)
class Quantity:
    """One thing that is compared. `hint` says what a difference may come from."""

    name: str
    label: str
    unit: str
    hint: str


FAR = f"beyond {NEAR_M[1]:g} m"
BANDS = (f"up to {NEAR_M[0]:g} m", f"{NEAR_M[0]:g} to {NEAR_M[1]:g} m", FAR)
SURFACES = "readings at edges, glass and dark surfaces are not modelled"
MOVED = "people, doors and what is not level"
SLIP = "a floor that is not the same everywhere, carpets and thresholds are not modelled"
QUANTITIES = (
    *(
        Quantity(f"residual_{k}", f"residual of ranges, {band}", "m", SURFACES)
        for k, band in enumerate(BANDS)
    ),
    *(
        Quantity(f"lost_{k}", f"beams lost on walls, {band}", "share", SURFACES)
        for k, band in enumerate(BANDS)
    ),
    Quantity(
        "silent",
        "beams of a scan without return",
        "share",
        "walls of a map are rougher than the real ones, so that fewer beams graze them",
    ),
    *(Quantity(f"way_{way:g}", f"odometry error over {way:g} m", "m", SLIP) for way in WAYS_M),
    Quantity("turn", "odometry error over half a turn", "rad", SLIP),
    Quantity("wander", "random error of the odometry's turn from scan to scan", "rad", SLIP),
    Quantity("jitter", "jitter of the scans' stamps", "s", "drivers, buses and clocks that stall"),
    Quantity("key_scans", "key scans", "1/m", "how often matching fails"),
    Quantity("entropy", "entropy of the map, by parts", "bit", MOVED),
    Quantity("walls", "share of walls in the map, by parts", "share", MOVED),
    Quantity("localisation", "localisation off the path of its own map", "m", MOVED),
    Quantity("agreement", "returns of a scan that its own map explains", "share", MOVED),
)
Samples = dict[str, Array]


def samples_of(recording: Recording, mapped: SlamResult, localised: Trajectory) -> Samples:
    """Samples (n,) of each quantity, NaN where the drive does not show it. `mapped` is its own map,
    `localised` where a filter has it on that map."""
    rows, own = recording.parts()[0]
    poses = mapped.trajectory.poses[rows]
    found = {**range_samples(own), **odometry_samples(own, poses), **_map_parts(mapped)}
    found["jitter"] = _jitter(own)
    keys = mapped.trajectory.poses[mapped.keys]
    found["key_scans"] = _rate(keys)
    step = apart(own)
    found["silent"], found["agreement"] = (
        found["silent"][::step],
        _agreement(own, localised.poses[rows], mapped.grid)[::step],
    )
    off = localised.poses.xy - mapped.trajectory.poses.xy
    found["localisation"] = np.hypot(*off.T)[:: apart(recording)]
    return found


def apart(recording: Recording) -> int:
    """Number of scans after which what they show is news."""
    return max(1, round(APART_S * len(recording) / max(recording.duration(), 1e-9)))


def range_samples(own: Recording) -> Samples:
    """Residuals of ranges on straight walls as their neighbours say, and shares of lost beams by scan."""
    walls = walls_of(own)
    band = np.digitize(walls.expected, NEAR_M)
    found: Samples = {}
    for k in range(len(BANDS)):
        here = band == k
        found[f"residual_{k}"] = np.abs(walls.off[here])
        # of a stretch of scans, so that there are enough
        part = walls.scan[here] // max(1, len(own) // 200)
        count = np.bincount(part)
        share = np.bincount(part, walls.lost[here]) / np.maximum(count, 1)
        found[f"lost_{k}"] = share[count >= LEAST_CELLS]
    known = ~np.isnan(own.ranges)
    back = own.lidar.returns(own.ranges)
    found["silent"] = 1.0 - back.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return found


def odometry_samples(own: Recording, poses: SE2) -> Samples:
    """How far odometry is off the map's path over ways and turns, one after another."""
    T_odom_base = own.T_odom_base
    if T_odom_base is None:
        return {}
    steps = poses.steps()
    way = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    turned = np.concatenate([[0.0], np.cumsum(np.abs(steps[:, 2]))])
    found: Samples = {}
    for length in WAYS_M:
        found[f"way_{length:g}"] = np.hypot(*_off(poses, T_odom_base, way, length)[:, :2].T)
    found["turn"] = np.abs(wrap(_off(poses, T_odom_base, turned, TURN_RAD)[:, 2]))
    off = wrap(T_odom_base.steps()[:, 2] - steps[:, 2])
    design = np.column_stack([steps[:, 2], np.hypot(steps[:, 0], steps[:, 1])])
    found["wander"] = np.abs(off - design @ np.linalg.lstsq(design, off, rcond=None)[0])
    return found


def _off(poses: SE2, T_odom_base: SE2, along: Array, length: float) -> Array:
    """Odometry's motion seen from the map's, (n, 3), over stretches of `length` that do not overlap."""
    ends = np.searchsorted(along, np.arange(0.0, along[-1], length))
    if len(ends) < 2:
        return np.zeros((0, 3))
    a, b = ends[:-1], ends[1:]
    map_motion = poses[a].inverse() @ poses[b]
    odom_motion = T_odom_base[a].inverse() @ T_odom_base[b]
    return (map_motion.inverse() @ odom_motion).xyt


def _rate(keys: SE2) -> Array:
    """Key scans a metre, over stretches of some metres one after another."""
    if len(keys) < 2:
        return np.zeros(0)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(keys.xy, axis=0).T))])
    return np.bincount((way // STRETCH_M).astype(np.int64))[:-1] / STRETCH_M


def _jitter(own: Recording) -> Array:
    """How much the time between scans differs from the usual one [s]."""
    waits = np.diff(own.stamps_ns) / 1e9
    return np.abs(waits - np.median(waits)) if len(waits) else waits


def _map_parts(mapped: SlamResult) -> Samples:
    """Entropy and share of walls in square parts of a map."""
    # in 255ths; no cell is certain
    grid, p = mapped.grid, (mapped.confidence + 0.5) / 256.0
    entropy = -(p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p))
    known = grid.cells >= FREE
    rows, cols = np.nonzero(known)
    side = max(1, round(TILE_M / grid.resolution))
    part = rows // side * (grid.shape[1] // side + 1) + cols // side
    count = np.bincount(part)
    enough = count >= LEAST_CELLS
    mean = np.bincount(part, entropy[known]) / np.maximum(count, 1)
    share = np.bincount(part, grid.cells[known] >= OCCUPIED_FROM) / np.maximum(count, 1)
    return {"entropy": mean[enough], "walls": share[enough]}


def _agreement(own: Recording, poses: SE2, grid: OccupancyGrid) -> Array:
    """Share of each scan's returns that end near a wall of a map."""
    distance = scipy.ndimage.distance_transform_edt(grid.cells < OCCUPIED_FROM) * grid.resolution
    back = own.lidar.returns(own.ranges)
    T_map_lidar = poses @ own.T_base_lidar
    angles = own.lidar.angles
    found = np.full(len(own), np.nan)
    for k in range(len(own)):
        r, angle = own.ranges[k, back[k]], angles[back[k]]
        if len(r):
            cells = grid.cell_of(T_map_lidar[k] @ np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1))
            cells = cells[grid.contains(cells)]
            found[k] = np.count_nonzero(distance[cells[:, 0], cells[:, 1]] <= EXPLAINED_M) / len(r)
    return found
