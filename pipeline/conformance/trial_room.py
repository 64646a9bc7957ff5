"""A room that parts are tried out in: what is in it, scans of it, a lap round its pillar, its map."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import require
from turtlebag.datasets.se2 import SE2, Array, compose
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import LidarSpec, Recording
from turtlebag.pipeline.conformance.answers import broken
from turtlebag.sim.raycast import cast
from turtlebag.sim.shapes import box, sections
from turtlebag.sim.world import World

LIDAR = LidarSpec(180, 0.0, math.radians(2.0), 0.12, 8.0)
HEIGHT_M, NOISE_M = 0.2, 0.01
BOXES = (
    ((4.0, -0.1), (8.2, 0.2)),
    ((4.0, 6.1), (8.2, 0.2)),
    ((-0.1, 3.0), (0.2, 6.2)),
    ((8.1, 3.0), (0.2, 6.2)),
    ((3.25, 3.0), (0.5, 2.0)),
    ((6.2, 0.75), (0.4, 1.5)),
)
"""Centres and sizes [m]: four walls, a pillar, a cupboard."""


def made(part: Callable[..., Any], contract: type, *given: object) -> Any:
    """The part, made as its contract says; AssertionError where it is not what that asks for."""
    if not callable(part):
        raise AssertionError(f"{part!r}: give a class, or a function that makes a {contract.__name__}")
    with told():
        if inspect.isclass(part):
            require(part, contract)
        one = part(*given)
        # The same contract for who is made otherwise: by a function, with settings of its own.
        methods = {name: value for name, value in vars(contract).items() if name != "__init__"}
        require(type(one), type(contract.__name__, (), methods))
    named = [key for key, value in vars(contract).items() if isinstance(value, property)]
    for key in [*named, *inspect.get_annotations(contract)]:
        if inspect.getattr_static(one, key, contract) is contract:
            raise broken(one, f"has no {key}, which {contract.__name__} requires")
    return one


@contextmanager
def told() -> Iterator[None]:
    """What is an InputError to the commands is an AssertionError of a check."""
    try:
        yield
    except InputError as error:
        raise AssertionError(str(error)) from None


def room() -> World:
    """The room."""
    shapes = tuple(box(f"box {k}", center, size, 0.0, (0.0, 1.0)) for k, (center, size) in enumerate(BOXES))
    return World("room", "burger", SE2.from_xyt(1.0, 1.0, 0.0), shapes, (-0.5, 8.5, -0.5, 6.5), (), {})


def lap(n: int = 80) -> Array:
    """Poses (n, 3) round the pillar, looking along the way."""
    t = np.linspace(0.0, 2.0 * math.pi, n)
    x, y = 3.25 + 1.9 * np.cos(t), 3.0 + 2.2 * np.sin(t)
    return np.column_stack([x, y, np.unwrap(np.arctan2(2.2 * np.cos(t), -1.9 * np.sin(t)))])


def ranges_from(poses: Array) -> NDArray[np.float32]:
    """What the lidar measures at poses (n, 3), (n, beams) float32, with its noise."""
    outlines, rng = sections(room().shapes, HEIGHT_M), stream(1, "noise")
    rows = []
    for x, y, yaw in poses:
        angles = yaw + LIDAR.angles
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        origins = np.tile([x, y], (len(angles), 1))
        rows.append(cast(origins, rays, angles, (outlines.segments, outlines.circles), LIDAR.range_max)[0])
    exact = np.array(rows)
    return (exact + rng.normal(0.0, NOISE_M, exact.shape)).astype(np.float32)


def wheels(poses: Array) -> Array:
    """Odometry (n, 3) of a drive along poses, from identity: two percent too far, and it turns a little."""
    steps = (SE2(poses[:-1]).inverse() @ SE2(poses[1:])).xyt * [1.02, 1.02, 1.0] + [0.0, 0.0, 2e-4]
    track = [np.zeros(3)]
    for step in steps:
        track.append(compose(track[-1], step))
    return np.array(track)


def log(poses: Array, *, odometry: bool = True) -> Recording:
    """The scans of a drive, five a second."""
    stamps = (np.arange(len(poses)) * 200_000_000 + 10**9).astype(np.int64)
    T_odom_base = SE2(wheels(poses)) if odometry else None
    return Recording("a room", stamps, ranges_from(poses), LIDAR, SE2.identity(), T_odom_base)


def bytes_of(*arrays: NDArray[Any]) -> bytes:
    """Arrays as one string of bytes."""
    return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)


def apart(T_a: SE2, T_b: SE2) -> tuple[float, float]:
    """How far two poses, or the farthest of (n,), are from each other [m], [rad]."""
    xyt = np.atleast_2d((T_a.inverse() @ T_b).xyt)
    return float(np.hypot(xyt[:, 0], xyt[:, 1]).max()), float(np.abs(xyt[:, 2]).max())


def require_near(part: object, where: str, T_a: SE2, T_b: SE2, most: tuple[float, float]) -> None:
    """AssertionError unless two poses, or all of (n,), are at most so far [m], [rad] from each other."""
    off = apart(T_a, T_b)
    if off[0] > most[0] or off[1] > most[1]:
        allowed = f"at most {most[0]:g} m, {most[1]:g} rad"
        raise broken(part, f"{where}: off by up to {off[0]:.3f} m, {off[1]:.3f} rad, {allowed}")


def require_information(part: object, what: str, information: Array) -> None:
    """AssertionError unless matrices (..., 3, 3) are symmetric and nowhere below zero."""
    scale = max(1.0, float(np.abs(information).max()))
    if not np.allclose(information, np.swapaxes(information, -1, -2), atol=1e-6 * scale):
        raise broken(part, f"{what}: the information must be symmetric")
    if np.linalg.eigvalsh(information).min() < -1e-6 * scale:
        raise broken(part, f"{what}: the information must not be negative in any direction")
