"""Teleop scripts: what a person with a joystick does, written down as YAML.

The driver is a simulated person who stands beside the robot and SEES it: it steers by the true pose.
It belongs to the recording, like the true trajectory; no estimator, planner or controller imports it,
and nothing of it reaches an Observation but the motion itself.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from datasets.errors import InputError
from datasets.se2 import Array
from datasets.types import Twist
from datasets.yaml_files import checked, find_named, known_names, read_mapping
from sim.driver import Driver
from sim.simulator import CONTROL_HZ, Truth
from sim.worlds import World

FOLDER = Path(__file__).parent / "scripts"

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Action = Generator[Twist, Truth, None]


class Step(BaseModel):
    """One action: exactly one of its keys (`steps` belongs to `repeat`)."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    drive: Finite | None = None
    """Metres straight on (negative: backwards)."""
    turn_deg: Finite | None = None
    """Degrees on the spot, counter-clockwise."""
    spin: Finite | None = None
    """Whole turns on the spot, counter-clockwise."""
    wait: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    """Seconds of standing still."""
    through: list[tuple[Finite, Finite]] | None = None
    """World points to drive through, turning on the spot at each."""
    route: str | None = None
    """A named route of the world, driven as `through`."""
    repeat: Annotated[int, Field(ge=1)] | None = None
    """How often to do `steps`."""
    steps: list[Step] = []

    @model_validator(mode="after")
    def _one_action(self) -> Step:
        given = [key for key in self.model_fields_set if key != "steps"]
        if len(given) != 1 or bool(self.steps) != (self.repeat is not None):
            raise ValueError(
                "a step has one action (drive, turn_deg, spin, wait, through, route, repeat+steps)"
            )
        return self


class Script(BaseModel):
    """A teleop script: speeds [m/s, rad/s] and steps."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    v: Positive = 0.16
    w: Positive = 0.6
    steps: list[Step]


def load_script(name_or_path: str) -> Script:
    """A built-in script by name or a YAML file by path; InputError for unknown names lists the known."""
    path = find_named(name_or_path, FOLDER, "teleop")
    return checked(Script, read_mapping(path), where=str(path))


def script_names() -> list[str]:
    """Names of the built-in scripts."""
    return known_names(FOLDER)


def check_script(script: Script, world: World) -> None:
    """InputError when the script names a route that the world does not have."""
    for name in _routes(script.steps):
        if name not in world.routes:
            known = ", ".join(sorted(world.routes)) or "none"
            raise InputError(
                f"teleop {script.name}: world {world.name} has no route '{name}' (it has: {known})"
            )


def _routes(steps: list[Step]) -> Iterator[str]:
    for step in steps:
        if step.route is not None:
            yield step.route
        yield from _routes(step.steps)


def commands(script: Script, world: World, max_v: float, max_w: float) -> Action:
    """The script as a generator: yields the next command, is sent the truth after it was driven.

    Prime it with `next` for nothing (it yields a first standstill), then `send` each Truth.
    """
    check_script(script, world)
    driver = Driver(min(script.v, max_v), min(script.w, max_w))
    truth = yield Twist()
    for step in script.steps:
        truth = yield from _act(step, driver, world, truth)


def _act(step: Step, driver: Driver, world: World, truth: Truth) -> Generator[Twist, Truth, Truth]:
    if step.drive is not None:
        return (yield from driver.drive(truth, step.drive))
    if step.turn_deg is not None:
        return (yield from driver.turn(truth, float(np.deg2rad(step.turn_deg))))
    if step.spin is not None:
        return (yield from driver.turn(truth, 2.0 * np.pi * step.spin))
    if step.wait is not None:
        return (yield from driver.wait(truth, round(step.wait * CONTROL_HZ)))
    if step.repeat is not None:
        for _ in range(step.repeat):
            for inner in step.steps:
                truth = yield from _act(inner, driver, world, truth)
        return truth
    points: Any = step.through if step.through is not None else world.routes[str(step.route)]
    return (yield from driver.through(truth, _as_points(points)))


def _as_points(points: Any) -> Array:
    return np.array(points, dtype=np.float64).reshape(-1, 2)
