"""The check of a localiser."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.conformance.trial_room import (
    HEIGHT_M,
    LIDAR,
    apart,
    broken,
    bytes_of,
    lap,
    made,
    ranges_from,
    require_information,
    require_near,
    room,
    told,
    wheels,
)
from turtlebag.pipeline.localisation.localiser import Localiser, require_estimate
from turtlebag.pipeline.localisation.parameters import AmclConfig

NEAR = 0.1, 0.05
"""How far off [m], [rad] it may be at the end of a lap."""


def check_localiser(localiser: Callable[..., Localiser]) -> None:
    """A lap on the map of a room from a pose that is a little off, a scan of nothing, and a search.

    AssertionError in one line says what the contract,
    `turtlebag.pipeline.localisation.localiser.Localiser`, asks.
    """
    poses = lap()
    odometry, ranges = wheels(poses), ranges_from(poses)
    first = _localised(localiser, poses, odometry, ranges)
    again = _localised(localiser, poses[:20], odometry, ranges)
    if bytes_of(first[0][:20]) != bytes_of(again[0]):
        raise broken(localiser, "the same scans and the same rng must give the same bytes")
    one = first[1]
    require_near(localiser, "the end of a lap", SE2(poses[-1]), one.T_map_odom @ SE2(odometry[-1]), NEAR)
    if not (one.converged and one.agrees) or one.lost:
        raise broken(localiser, "after a lap it must be converged, agree with the map and not be lost")
    T_odom, before = SE2(odometry[-1]), bytes_of(one.T_map_odom.xyt)
    one.contradicted(_scan(len(poses), ranges[0]), T_odom, T_odom)
    if bytes_of(one.T_map_odom.xyt) != before:
        raise broken(localiser, "contradicted: must change nothing")
    one.update(_scan(len(poses), np.full_like(ranges[0], np.inf)), T_odom, T_odom)
    _require_estimate(one)
    one.initialise_globally()
    for k in range(0, 40, 8):
        one.update(_scan(200 + k, ranges[k]), SE2(odometry[k]), SE2(odometry[k]))
        _require_estimate(one)


def _localised(
    localiser: Callable[..., Localiser], poses: Array, odometry: Array, ranges: NDArray[np.float32]
) -> tuple[Array, Localiser]:
    """What it says at each scan (n, 3), and the localiser then."""
    grid, rng = room().rasterize(HEIGHT_M), stream(1, "localiser")
    before = bytes_of(grid.cells, ranges, odometry)
    one: Localiser = made(localiser, Localiser, grid, LIDAR, SE2.identity(), AmclConfig(), rng)
    if one.initialised:
        raise broken(one, "initialised: must be false before it has a pose")
    start = SE2(poses[0]) @ SE2.from_xyt(0.1, -0.1, 0.05)
    one.initialise(start, None, SE2(odometry[0]))
    if not one.initialised or max(apart(one.T_map_odom, start @ SE2(odometry[0]).inverse())) > 1e-6:
        raise broken(one, "initialise: with the odometry now, T_map_odom must be known at once")
    said = []
    for k in range(len(poses)):
        used = one.update(_scan(k, ranges[k]), SE2(odometry[k]), SE2(odometry[k]))
        if not isinstance(used, bool | np.bool_):
            raise broken(one, "update: must return whether the scan was used")
        _require_estimate(one)
        require_information(one, "covariance", one.covariance)
        said.append(one.T_map_odom.xyt)
    if bytes_of(grid.cells, ranges, odometry) != before:
        raise broken(one, "it must not change the map, the scans or the odometry")
    return np.array(said), one


def _scan(k: int, ranges: NDArray[np.float32]) -> Scan:
    return Scan(10**9 + k * 200_000_000, ranges, LIDAR)


def _require_estimate(localiser: Localiser) -> None:
    with told():
        require_estimate(localiser)
