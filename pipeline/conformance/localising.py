"""The check of a localiser."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.conformance.answers import BOOL, INT, broken, require_attributes, require_value
from turtlebag.pipeline.conformance.trial_room import (
    HEIGHT_M,
    LIDAR,
    apart,
    bytes_of,
    lap,
    made,
    ranges_from,
    require_information,
    require_near,
    room,
    wheels,
)
from turtlebag.pipeline.localisation.localiser import Localiser
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
        require_value(one, "update: whether the scan was used", used, BOOL)
        _require_estimate(one)
        require_information(one, "covariance", one.covariance)
        said.append(one.T_map_odom.xyt)
    if bytes_of(grid.cells, ranges, odometry) != before:
        raise broken(one, "it must not change the map, the scans or the odometry")
    return np.array(said), one


def _scan(k: int, ranges: NDArray[np.float32]) -> Scan:
    return Scan(10**9 + k * 200_000_000, ranges, LIDAR)


def _require_estimate(one: Localiser) -> None:
    try:
        T_map_odom, covariance = one.T_map_odom, one.covariance
    except ValueError as error:
        raise broken(one, f"update: T_map_odom or covariance is not known after a scan: {error}") from None
    require_attributes(
        one, "update", one,
        T_map_odom=SE2, converged=BOOL, agrees=BOOL, lost=BOOL, searches=INT, agreement=(), particles=SE2,
    )  # fmt: skip
    require_value(one, "update: T_map_odom", T_map_odom.xyt, (3,))
    require_value(one, "update: covariance", covariance, (3, 3))
    if not -1e-6 <= one.agreement <= 1.0 + 1e-6:
        raise broken(one, f"update: agreement must be a share 0..1, not {one.agreement:g}")
    if one.particles.xyt.ndim != 2 or not len(one.particles):
        raise broken(one, "update: particles must be poses (n,), at least one")
