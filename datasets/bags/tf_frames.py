"""The frames of a recorded robot: sensor poses from /tf_static and constant links of /tf."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from turtlebag.datasets.bags.decode import RawTransform
from turtlebag.datasets.bags.plausibility import far_away
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import rotations

BASES = ("base_footprint", "base_link")
"""Names of a robot's base frame."""


def matrix(xyz: Iterable[float], quaternion: Iterable[float]) -> Array:
    """Homogeneous (4, 4) matrix of a translation and a quaternion x, y, z, w (normalised here)."""
    q = np.array(list(quaternion), dtype=np.float64)
    out = np.eye(4)
    out[:3, :3] = rotations(q / (np.linalg.norm(q) or 1.0))
    out[:3, 3] = list(xyz)
    return out


class FrameTree:
    """Links between frames; a link that changes is kept apart as moving, `far` are those left out."""

    def __init__(self) -> None:
        self.fixed: dict[tuple[str, str], Array] = {}
        self.moving: dict[tuple[str, str], list[RawTransform]] = {}
        self.far: set[tuple[str, str]] = set()
        self._first: dict[tuple[str, str], RawTransform] = {}

    def add(self, transform: RawTransform, *, static: bool) -> None:
        """Add one transform of /tf or /tf_static; implausibly distant ones are left out."""
        link = transform.parent, transform.child
        if not np.isfinite((*transform.xyz, *transform.quaternion)).all():
            return
        if far_away(transform.xyz):
            self.far.add(link)
            return
        if link in self.moving:
            self.moving[link].append(transform)
            return
        first = self._first.get(link)
        if first is None:
            self._first[link] = transform
            self.fixed[link] = matrix(transform.xyz, transform.quaternion)
        if not static:
            self._stream(link, transform)

    def _stream(self, link: tuple[str, str], transform: RawTransform) -> None:
        """Links of the odometry are streams even while the robot stands still."""
        first = self._first[link]
        moved = transform.xyz != first.xyz or transform.quaternion != first.quaternion
        if moved or link[0] in ("odom", "map", "world"):
            self.moving[link] = [first] if moved and transform is not first else []
            self.moving[link].append(transform)
            self.fixed.pop(link, None)

    def frames(self) -> set[str]:
        """Every frame seen."""
        return {frame for link in (*self.fixed, *self.moving) for frame in link}

    def base(self, otherwise: str = BASES[0]) -> str:
        """Name of the robot's base frame among those seen, or else that one."""
        known = self.frames()
        return next((frame for frame in BASES if frame in known), otherwise)

    def lookup(self, target: str, source: str) -> Array | None:
        """`T_target_source` (4, 4) over fixed links only; None when they do not connect."""
        found = {target: np.eye(4)}
        queue = deque([target])
        while queue:
            frame = queue.popleft()
            if frame == source:
                return found[frame]
            for (parent, child), T_parent_child in self.fixed.items():
                if parent == frame and child not in found:
                    found[child] = found[frame] @ T_parent_child
                    queue.append(child)
                elif child == frame and parent not in found:
                    found[parent] = found[frame] @ np.linalg.inv(T_parent_child)
                    queue.append(parent)
        return found.get(source)
