"""The frames of a recorded robot: sensor poses from /tf_static and constant links of /tf."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter

import numpy as np

from turtlebag.datasets.bags.decode import RawTransform
from turtlebag.datasets.bags.plausibility import far_away
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.plurals import counted, listed, verb
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import rotations

BASES = ("base_footprint", "base_link")
"""Names of a robot's base frame."""
Link = tuple[str, str]
"""Parent and child."""


def matrix(xyz: Iterable[float], quaternion: Iterable[float]) -> Array:
    """Homogeneous (4, 4) matrix of a translation and a quaternion x, y, z, w (normalised here)."""
    q = np.array(list(quaternion), dtype=np.float64)
    out = np.eye(4)
    out[:3, :3] = rotations(q / (np.linalg.norm(q) or 1.0))
    out[:3, 3] = list(xyz)
    return out


class FrameTree:
    """Links between frames; one that changes is kept apart as moving, impossible transforms are left out."""

    def __init__(self) -> None:
        self.fixed: dict[Link, Array] = {}
        self.moving: dict[Link, list[RawTransform]] = {}
        self.times: dict[Link, list[tuple[int, int]]] = {}
        """Stamps and log times [ns] of each link of /tf."""
        self._first: dict[Link, RawTransform] = {}
        self._far: Counter[Link] = Counter()
        self._bad: Counter[tuple[str, str]] = Counter()
        """Quaternions that are none, by topic and by what is made of them."""

    def add(self, transform: RawTransform, *, static: bool) -> None:
        """Add one transform of /tf or /tf_static; those without a place or a direction are left out."""
        link = transform.parent, transform.child
        if not static:
            self.times.setdefault(link, []).append((transform.stamp_ns, transform.log_time_ns))
        if not self._possible(transform, "/tf_static" if static else "/tf"):
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

    def _possible(self, transform: RawTransform, topic: str) -> bool:
        norm = float(np.linalg.norm(transform.quaternion))
        if not 1e-6 < norm < np.inf:
            self._bad[topic, "left out"] += 1
            return False
        if abs(norm - 1.0) > 0.01:
            self._bad[topic, "normalised here"] += 1
        if far_away(transform.xyz):
            self._far[transform.parent, transform.child] += 1
            return False
        return True

    def _stream(self, link: Link, transform: RawTransform) -> None:
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

    def parents(self) -> dict[str, list[str]]:
        """The parents of each frame that has one, sorted."""
        parents: dict[str, list[str]] = {}
        for parent, child in sorted({*self.fixed, *self.moving}):
            parents.setdefault(child, []).append(parent)
        return parents

    def base(self, otherwise: str = BASES[0]) -> str:
        """Name of the robot's base frame among those seen, or else that one."""
        known = self.frames()
        return next((frame for frame in BASES if frame in known), otherwise)

    def lookup(self, target: str, source: str) -> Array | None:
        """`T_target_source` (4, 4) over fixed links only; None when they do not connect.

        The way down from the target comes first: where the links form a loop, it is the one meant.
        """
        for up in (False, True):
            T_target_source = self._path(target, up=up).get(source)
            if T_target_source is not None:
                return T_target_source
        return None

    def _path(self, target: str, *, up: bool) -> dict[str, Array]:
        """`T_target_frame` of every frame below a target or, with `up`, connected to it in any direction."""
        beside: dict[str, list[tuple[str, Array]]] = {}
        for (parent, child), T_parent_child in self.fixed.items():
            beside.setdefault(parent, []).append((child, T_parent_child))
            if up:
                T_child_parent: Array = np.linalg.inv(T_parent_child).astype(np.float64)
                beside.setdefault(child, []).append((parent, T_child_parent))
        T_target = {target: np.eye(4)}
        queue = deque([target])
        while queue:
            frame = queue.popleft()
            for other, T_frame_other in beside.get(frame, ()):
                if other not in T_target:
                    T_target[other] = T_target[frame] @ T_frame_other
                    queue.append(other)
        return T_target

    def findings(self) -> Iterator[Finding]:
        """What is wrong with the transforms that were added."""
        for (topic, remedy), count in sorted(self._bad.items()):
            wrong = "not normalised" if remedy == "normalised here" else "zero or not finite"
            what = f"{counted(count, 'quaternion')} {verb(count, 'is', 'are')} {wrong}"
            yield Finding("bad quaternions", topic, what, count, remedy=remedy)
        for (parent, child), count in sorted(self._far.items()):
            what = f"the transform {parent} -> {child} is implausibly far away"
            yield Finding("absurd places", "", what, count, remedy="left out")
        parents = self.parents()
        for child, several in parents.items():
            if len(several) > 1:
                what = f"frame '{child}' has several parents: {listed(several)}"
                yield Finding("two parents", "", what, len(several))
        if loop := _loop(parents):
            named = loop if len(loop) <= 13 else [*loop[:9], f"{len(loop) - 13} more", *loop[-4:]]
            what = f"the transforms form a loop: {' -> '.join(named)}"
            yield Finding(
                "transform loop", "", what, len(loop) - 1, remedy="the way down from the base is used"
            )


def _loop(parents: dict[str, list[str]]) -> list[str]:
    """Frames of a loop from one to itself, parents first; empty without any."""
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        loop: list[str] = error.args[1][:-1]
        first = loop.index(min(loop))
        return [*loop[first:], *loop[: first + 1]]
    return []
