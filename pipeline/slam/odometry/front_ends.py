"""The front ends, by their names in the setting `front_end`."""

from __future__ import annotations

from typing import Annotated

from turtlebag.datasets.parts import chosen, part_of
from turtlebag.pipeline.slam.odometry.front_end import FrontEnd
from turtlebag.pipeline.slam.odometry.kiss import KissIcp
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.tracker import Maker
from turtlebag.pipeline.slam.odometry.wheels import Wheels

FRONT_ENDS: dict[str, Maker] = {"lines": Lines, "kiss_icp": KissIcp, "wheels": Wheels}
FrontEndName = Annotated[str, part_of(*FRONT_ENDS)]


def front_end_maker(name: str) -> Maker:
    """The front end class of that name; InputError if it is a user's and cannot be loaded."""
    maker: Maker = chosen(name, FRONT_ENDS, FrontEnd)
    return maker
