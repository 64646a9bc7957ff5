"""A turning 3D lidar: rings of beams at fixed elevations, each azimuth at its own instant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Cloud
from turtlebag.sim.raycast import beam_rays
from turtlebag.sim.raycast3d import Scene
from turtlebag.sim.robots import Lidar3dMount
from turtlebag.sim.shapes import Solid


class Lidar3d:
    """Turns base poses over a sweep into a cloud."""

    def __init__(
        self, solids: Sequence[Solid], mount: Lidar3dMount, sigma: float, rng: np.random.Generator
    ) -> None:
        self._mount, self._sigma, self._rng = mount, sigma, rng
        self._angles: Array = np.linspace(0.0, 2.0 * np.pi, mount.n_azimuths, endpoint=False)
        self._share: Array = np.asarray(np.arange(mount.n_azimuths) / mount.n_azimuths, dtype=np.float64)
        low, high = np.deg2rad(mount.elevation_deg)
        self._elevations: Array = np.linspace(low, high, mount.n_rings)
        self._scene = Scene(solids)
        self._movers: list[Sequence[Array]] = []
        self._moving: list[Scene] = []

    def know_movers(self, solids: Sequence[Solid]) -> None:
        """The movers' solids, each standing at the origin of its own frame."""
        self._moving = [Scene([solid]) for solid in solids]

    def note_movers(self, positions: Sequence[Array], first: bool) -> None:
        """Where the movers stand in the control step just taken, (2,) each; `first`: of a sweep."""
        self._movers = [positions] if first else [*self._movers, positions]

    def true_ranges(self, poses: Array) -> Array:
        """Distances (n_azimuths, n_rings) without noise or limits; poses as for the planar lidar."""
        x, y, z = self._mount.position
        when: Array = self._share * float(len(poses) - 1)
        origins, directions, _ = beam_rays(poses, when, np.array([x, y, 0.0]), self._angles)
        tangents: Array = np.tan(self._elevations)
        level = self._scene.cast(origins, directions, z, tangents)
        step = np.minimum(when.astype(np.int64), len(self._movers) - 1)
        for number, positions in enumerate(self._movers):
            beams = np.nonzero(step == number)[0]
            for scene, position in zip(self._moving, positions, strict=True):
                near = scene.cast(origins[beams] - position, directions[beams], z, tangents)
                level[beams] = np.minimum(level[beams], near)
        return np.asarray(level / np.cos(self._elevations))

    def measure(self, poses: Array) -> Cloud:
        """The points that came back, in the order of their instants, in the lidar frame."""
        ranges = self.true_ranges(poses)
        seen = (ranges >= self._mount.range_min) & (ranges <= self._mount.range_max)
        noisy = ranges + self._sigma * self._rng.standard_normal(ranges.shape)
        azimuth, ring = np.nonzero(seen)
        r, up = noisy[seen], self._elevations[ring]
        level = r * np.cos(up)
        points = np.stack(
            [level * np.cos(self._angles[azimuth]), level * np.sin(self._angles[azimuth]), r * np.sin(up)], -1
        )
        times = self._share[azimuth] / self._mount.rate_hz if len(poses) > 1 else None
        return Cloud(points, times)
