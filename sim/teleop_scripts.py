"""Teleop scripts in YAML (keyboard teleop is in `pipeline/terminal/keyboard_teleop.py`).

The driver is a simulated person who watches the robot: it steers by the true pose.
It belongs to the recording, like the true trajectory; no estimator, planner or controller imports it,
and only the motion itself reaches an Observation.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from turtlebag.datasets.durations import LONGEST_S, Seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.settings import Finite, Positive, Settings
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import checked, find_named, known_names, read_mapping
from turtlebag.sim.robots import RobotSpec
from turtlebag.sim.routes import EXACT_SIDE_M, SIDE_M, RoutePlanner, random_goals, route
from turtlebag.sim.script_driver import Driver
from turtlebag.sim.simulator import CONTROL_HZ, Truth
from turtlebag.sim.world import World

FOLDER = Path(__file__).parent / "scripts"

Action = Generator[Twist, Truth, None]

ACTIONS = ("drive", "turn_deg", "spin", "wait", "through", "route", "wall_follow", "random_walk", "repeat")
WEAVE_RAD = 0.5
"""How far the `spiral` style swings its heading."""
CIRCLE_M = 0.2
"""Radius of the circles it drives where there is room."""


Metres = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]


class Step(Settings):
    """One action: exactly one of its keys (`steps` belongs to `repeat`)."""

    drive: Metres | None = None
    """Metres straight on (negative: backwards)."""
    turn_deg: Annotated[float, Field(ge=-1e7, le=1e7)] | None = None
    """Degrees on the spot, counter-clockwise."""
    spin: Annotated[float, Field(ge=-1e5, le=1e5)] | None = None
    """Whole turns on the spot, counter-clockwise."""
    wait: Seconds | None = None
    """Seconds of standing still."""
    through: Annotated[list[tuple[Finite, Finite]], Field(max_length=10_000)] | None = None
    """World points to drive through, turning on the spot at each."""
    route: str | None = None
    """A route of the world: one in its file, or a planned one (`tour`, `perimeter_then_rooms`)."""
    wall_follow: Annotated[float, Field(gt=0.0, le=LONGEST_S)] | None = None
    """Seconds of driving with the wall to the right."""
    random_walk: Annotated[float, Field(gt=0.0, le=10_000.0)] | None = None
    """Metres of driving to random reachable, collision-free places."""
    repeat: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """How often to do `steps`."""
    steps: list[Step] = Field(default=[])

    @model_validator(mode="after")
    def _one_action(self) -> Step:
        given = [key for key in self.model_fields_set if key != "steps"]
        if len(given) != 1 or bool(self.steps) != (self.repeat is not None):
            raise ValueError(f"a step has one action ({', '.join(ACTIONS)})")
        return self


class Script(Settings):
    """A teleop script: speeds [m/s, rad/s] and steps."""

    name: str
    v: Positive = 0.16
    w: Positive = 0.6
    style: Literal["turn_then_drive", "flowing", "spiral"] = "turn_then_drive"
    """Through points: turning on the spot at each, without stopping, or swinging and circling."""
    steps: list[Step]


def load_script(name_or_path: str) -> Script:
    """A built-in script by name or a YAML file by path; InputError for unknown names lists the known."""
    path = find_named(name_or_path, FOLDER, "teleop")
    return checked(Script, read_mapping(path), where=str(path))


def script_names() -> list[str]:
    """Names of the built-in scripts."""
    return known_names(FOLDER)


def commands(script: Script, world: World, robot: RobotSpec, seed: int) -> Action:
    """The script as a generator: yields the next command, is sent the truth after it was driven.

    Prime it with `next` for nothing (it yields a first standstill), then `send` each Truth. It
    raises InputError at once for a route that the world does not have, and Stuck under way.
    """
    person = _Person(script, world, robot, seed)
    for name in _routes(script.steps):
        person.route(name)
    return person.drive()


def _routes(steps: list[Step]) -> Iterator[str]:
    for step in steps:
        if step.route is not None:
            yield step.route
        yield from _routes(step.steps)


class _Person:
    """Drives a script: hands (the driver) and a plan (the routes)."""

    def __init__(self, script: Script, world: World, robot: RobotSpec, seed: int) -> None:
        self._script, self._world, self._robot = script, world, robot
        self._hands = Driver(min(script.v, robot.limits.max_v), min(script.w, robot.limits.max_w))
        self._rng = stream(seed, "teleop")
        self._planned: dict[str, Array] = {}

    @cached_property
    def planner(self) -> RoutePlanner:
        """Ways through this world for this robot."""
        return RoutePlanner(self._world, self._robot)

    def route(self, name: str) -> Array:
        """A route by name, planned once."""
        if name not in self._planned:
            exact = self._script.style == "turn_then_drive"
            self._planned[name] = route(name, self.planner, EXACT_SIDE_M if exact else SIDE_M)
        return self._planned[name]

    def drive(self) -> Action:
        """All steps of the script."""
        truth = yield Twist()
        for step in self._script.steps:
            truth = yield from self._act(step, truth)

    def _act(self, step: Step, truth: Truth) -> Generator[Twist, Truth, Truth]:
        hands = self._hands
        if step.drive is not None:
            return (yield from hands.drive(truth, step.drive))
        if step.turn_deg is not None:
            return (yield from hands.turn(truth, float(np.deg2rad(step.turn_deg))))
        if step.spin is not None:
            return (yield from hands.turn(truth, 2.0 * np.pi * step.spin))
        if step.wait is not None:
            return (yield from hands.wait(truth, round(step.wait * CONTROL_HZ)))
        if step.repeat is not None:
            for _ in range(step.repeat):
                begun = truth
                for inner in step.steps:
                    truth = yield from self._act(inner, truth)
                if truth is begun:  # no time passes, however often they are done
                    break
            return truth
        if step.wall_follow is not None:
            return (yield from self._follow_wall(truth, step.wall_follow))
        return (yield from self._along(truth, self._points(step)))

    def _points(self, step: Step) -> Array:
        if step.through is not None:
            return np.array(step.through, dtype=np.float64).reshape(-1, 2)
        if step.random_walk is not None:
            return random_goals(self.planner, self._rng, step.random_walk)
        return self.route(str(step.route))

    def _along(self, truth: Truth, points: Array) -> Generator[Twist, Truth, Truth]:
        if self._script.style == "turn_then_drive":
            return (yield from self._hands.through(truth, points))
        if self._script.style == "flowing":
            return (yield from self._hands.flow(truth, points))
        for point in points:
            truth = yield from self._hands.flow(truth, point[None], weave=WEAVE_RAD)
            needed = self._robot.model.circumscribed_radius + 2.0 * CIRCLE_M + SIDE_M
            if self.planner.room(*truth.T_world_base.xy.tolist()) > needed:
                truth = yield from self._hands.circle(truth, CIRCLE_M)
        return truth

    def _follow_wall(self, truth: Truth, duration: float) -> Generator[Twist, Truth, Truth]:
        planner = self.planner
        if not self._world.shapes:
            raise InputError(f"teleop {self._script.name}: world {self._world.name} has no wall to follow")
        aside = self._robot.model.circumscribed_radius + 0.2
        beside = np.nonzero(np.abs(planner.rooms - aside) < 0.08)[0]
        cost, before = planner.ways_from(planner.nearest(truth.T_world_base.xy))
        start = int(beside[np.argmin(cost[beside])])
        points = planner.straightened(planner.places[planner.way(before, start)])
        truth = yield from self._hands.through(truth, points)
        return (yield from self._hands.follow_wall(truth, planner.room, aside, round(duration * CONTROL_HZ)))
