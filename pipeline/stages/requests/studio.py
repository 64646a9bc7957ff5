"""Requests for the studio."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.stages.parser import port_number
from turtlebag.pipeline.stages.requests.options import (
    ConfigFile,
    MapFile,
    Option,
    Overrides,
    Robot,
    Seed,
    World,
    file,
    flag,
    on_map,
)
from turtlebag.pipeline.stages.requests.request import Request


class StudioRequest(Request):
    """A session of the studio: a robot to drive or a bag to play in the browser, or an earlier one again."""

    VERB = "studio"
    EXAMPLE = "turtlebag studio --world turtlebot3_world --robot burger --seed 1"

    world: World = "turtlebot3_world"
    robot: Robot = None
    seed: Seed = 1
    map: Annotated[MapFile | None, on_map("start")] = None
    bag: Annotated[
        Path | None, file("BAG", "bag or log to play and map, in place of a simulation", "rec")
    ] = None
    edits: Annotated[
        Path | None, file("FILE", "with --bag: edits of an earlier session to go on with", "edits.yaml")
    ] = None
    port: Annotated[
        Annotated[int, Field(ge=1, le=65535)] | None,
        Option("P", "port of the page (default: a free one)", "8000", read=port_number),
    ] = None
    host: Annotated[
        str | None,
        Option(
            "H",
            "address to listen on (default: this machine only); on any other, anyone who knows the page's "
            "address can drive",
            "0.0.0.0",
        ),
    ] = None
    browser: Annotated[bool, flag("only print the page's address, do not open it", "--no-browser")] = True
    session: Annotated[
        Path | None,
        file("FILE", "replay a session.yaml without a page; needs --out", "session.yaml", name="--replay"),
    ] = None
    config: ConfigFile = None
    settings: Overrides = Field({})

    def replayed(self) -> Path:
        """The session file to replay; InputError for a session that a person drives."""
        if self.session is None:
            raise InputError("studio: a person drives; give --replay a session.yaml to drive again")
        return self.session
