"""What is mapped, and what is localised: recordings, and what a person says of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import unchanged
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.session_file import FILE as GRAPH
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest, MapRequest
from turtlebag.pipeline.stages.requests.options import XYT
from turtlebag.pipeline.stages.requests.robots import IdentifyRequest, TwinRequest

Word = TypeVar("Word")


@dataclass(frozen=True)
class Source:
    """A bag or log. `T_base_lidar` and `upside_down` override how it says the laser sits on the robot.

    `topics` names the scans of a bag, LaserScan (also those of several lidars) or PointCloud2; without it
    they are those of all lidars that have transforms, of /scan or of the only LaserScan topic, and where
    there is none the point clouds.
    """

    path: Path
    T_base_lidar: SE2 | None = None
    upside_down: bool = False
    topics: tuple[str, ...] = ()

    @staticmethod
    def of(request: MapRequest | LocaliseRequest | IdentifyRequest | TwinRequest) -> Source:
        """What a request reads."""
        laser = request.laser
        over = bool(laser and laser.upside_down)
        return Source(request.source, laser and laser.T_base_lidar, over, request.topic)

    def load(self) -> Recording:
        """Its planar scans; InputError when it has none, or changes while it is read."""
        laser, over = self.T_base_lidar, self.upside_down
        with unchanged(self.path):
            return load_recording(self.path, T_base_lidar=laser, upside_down=over, topic=self.topics)


def pose_or_word(pose: XYT | Word) -> SE2 | Word:
    """The pose that an option says, or the word that stands in its place."""
    return SE2.from_xyt(*pose) if isinstance(pose, tuple) else pose


@dataclass(frozen=True)
class MapInputs:
    """What a map is made of. `also` are later recordings of the same place, joined into one graph.

    `continued` is the folder of an earlier map, whose graph they join without it being made again. `edits` is
    a file of loops and walls that a person rejected or added.
    """

    source: Source
    also: Sequence[Path] = ()
    continued: Path | None = None
    edits: Path | None = None

    def later(self) -> Iterator[Recording]:
        """The recordings that are joined to the first."""
        return (replace(self.source, path=path).load() for path in self.also)

    def refuse_planar(self) -> None:
        """InputError for what only planar scans can be mapped with."""
        topics = self.source.topics
        given = {
            "--topic": " ".join(topics) if len(topics) > 1 else None,
            "--also": self.also or None,
            "--laser": self.source.T_base_lidar,
            "--continue": self.continued,
            "--edits": self.edits,
        }
        for option in (option for option, value in given.items() if value is not None):
            source = self.source.path
            raise InputError(f"{option}: for 2D scans only, but {source} is mapped in 3D") from None

    def files(self) -> dict[str, Path]:
        """All of them by the names that a manifest gives them."""
        continued = None if self.continued is None else self.continued / GRAPH
        also = {f"also_{k}": path for k, path in enumerate(self.also, start=1)}
        others = {"continued": continued, "edits": self.edits}
        given = {name: path for name, path in others.items() if path is not None}
        return {"source": self.source.path, **also, **given}
