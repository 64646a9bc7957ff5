"""A spinning 3D lidar: rings of beams at fixed elevations, each azimuth at its own time."""

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
        self,
        solids: Sequence[Solid],
        mount: Lidar3dMount,
        sigma: float,
        rng: np.random.Generator,
        moving: Sequence[Solid] = (),
    ) -> None:
        """`moving` solids each stand at the origin of their own frame."""
        self._mount, self._sigma, self._rng = mount, sigma, rng
        self._angles: Array = np.linspace(0.0, 2.0 * np.pi, mount.n_azimuths, endpoint=False)
        self._share: Array = np.asarray(np.arange(mount.n_azimuths) / mount.n_azimuths, dtype=np.float64)
        low, high = np.deg2rad(mount.elevation_deg)
        self._elevations: Array = np.linspace(low, high, mount.n_rings)
        self.surround(solids)
        self._movers: list[Sequence[Array]] = []
        self._moving = [Scene([solid]) for solid in moving]

    def surround(self, solids: Sequence[Solid]) -> None:
        """Set the solids around the lidar from now on."""
        self._scene = Scene(solids)

    def turn(self) -> tuple[float, float]:
        """Begin a turn: its share of the nominal time, and how late it is stamped [s]."""
        return 1.0, 0.0

    def note_movers(self, positions: Sequence[Array], earlier: int) -> None:
        """Where the movers stand in this control step, (2,) each; `earlier`: steps before it in the turn."""
        self._movers = [*self._movers[len(self._movers) - earlier :], positions]

    def true_ranges(self, poses: Array, begin: float = 0.0, end: float | None = None) -> Array:
        """Distances (n_azimuths, n_rings) without noise or limits; arguments as for the planar lidar."""
        x, y, z = self._mount.position
        when: Array = begin + self._share * ((len(poses) - 1.0 if end is None else end) - begin)
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

    def measure(self, poses: Array, begin: float = 0.0, end: float | None = None) -> Cloud:
        """The points that came back, in the order of their instants, in the lidar frame."""
        ranges = self.true_ranges(poses, begin, end)
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
