"""Requests for pages about outputs, also beside those of other systems."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import BeforeValidator, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.stages.requests.options import (
    POSE,
    RAD,
    XYT,
    Option,
    clock_shift,
    file,
    flag,
    flag_of,
    of_system,
    pose,
    system_file,
)
from turtlebag.pipeline.stages.requests.request import Request

SystemFile = Annotated[tuple[str, Path], BeforeValidator(system_file)]


SYSTEM_OPTIONS = ("system_base", "system_times", "system_shift")


class SystemsRequest(Request):
    """How the files of other systems are read, by the systems' names."""

    system_base: Annotated[
        tuple[Annotated[tuple[str, XYT], of_system(pose)], ...],
        Option(
            f"[NAME=]{POSE}",
            "pose on the robot of the sensor that the other system's trajectory follows",
            "0.1,0,0",
            RAD,
        ),
    ] = ()
    system_times: Annotated[
        tuple[Annotated[tuple[str, Path], of_system(Path)], ...],
        Option(
            "[NAME=]FILE",
            "times of the KITTI poses in seconds, one per line (default: those of the scans)",
            "times.txt",
        ),
    ] = ()
    system_shift: Annotated[
        tuple[Annotated[tuple[str, float], of_system(clock_shift)], ...],
        Option("[NAME=]SECONDS", "time to add to the stamps", "other=0.5", "s"),
    ] = ()


class ReportRequest(SystemsRequest):
    """A page of stage outputs."""

    VERB = "report"
    EXAMPLE = "turtlebag report data/record data/map data/patrol --out data/report"

    folders: Annotated[
        tuple[Path, ...],
        file("DIR", "outputs of record, map, localise, plan and navigate", "rec", positional=True),
    ]
    paper: Annotated[bool, flag("also save each figure as PDF and PNG")] = False
    index: Annotated[bool, flag("make a sortable table of all outputs below DIR instead")] = False
    animate: Annotated[bool, flag("leave out the animations, for a smaller page", "--no-animation")] = True
    system: Annotated[
        tuple[SystemFile, ...],
        Option(
            "[NAME=]FILE",
            "file of another system to show next to ours (see compare)",
            "other=poses.tum",
        ),
    ] = ()

    def files(self) -> list[Path]:
        """The inputs: for an index, those found below the folders, which may also hold the index."""
        return [] if self.index else super().files()

    @model_validator(mode="after")
    def _only_what_an_index_uses(self) -> Self:
        for name in ("paper", "animate", "system", *SYSTEM_OPTIONS) if self.index else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                option = "--no-animation" if name == "animate" else flag_of(name)
                raise InputError(f"{option}: has no effect with --index; remove it")
        return self


class CompareRequest(SystemsRequest):
    """The differences between outputs or runs of one stage, or between ours and other systems'."""

    VERB = "compare"
    EXAMPLE = (
        "turtlebag compare data/maps/a cartographer=poses.tum cartographer=map.yaml --out data/comparison"
    )

    a: Annotated[
        Path,
        file(
            "A",
            "output of record, map, localise, plan or navigate; or a folder with such outputs, one for each "
            "run (seed) of a system",
            "map",
            positional=True,
        ),
    ]
    b: Annotated[
        tuple[SystemFile, ...],
        Option(
            "B|[NAME=]FILE",
            "other outputs of the same stage, or folders of runs, each compared with A and in pairs of one "
            "seed; or files of other systems: trajectories (TUM, KITTI, EuRoC csv) and maps (yaml), the two "
            "of one system under one NAME",
            "map2",
            positional=True,
        ),
    ]
