"""Maps for the navigation benchmark: made by our own SLAM from a recorded tour, once, and kept."""

from __future__ import annotations

from pathlib import Path

from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.record import record
from turtlebag.sim.simulator import Sensors, SimConfig

TOUR_SEED = 1


class Maps:
    """Maps below a folder, one for each world and robot, by the sensors that the tour was recorded with."""

    def __init__(self, folder: Path, sensors: Sensors) -> None:
        self._folder, self._sensors = folder, sensors

    def slam(self, world: str, robot: str) -> Path:
        """map.yaml of a world as mapped from the robot's own tour of it."""
        place = self._folder / "".join(c if c.isalnum() else "_" for c in f"{world} {robot} {self._sensors}")
        if not (place / "map" / "manifest.json").exists():
            sim = SimConfig(sensors=self._sensors)
            record(world, robot, "tour", TOUR_SEED, place / "record", sim=sim, force=True)
            build_map(place / "record", place / "map", force=True)
        return place / "map" / "map.yaml"
