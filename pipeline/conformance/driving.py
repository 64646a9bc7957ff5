"""Checks of parts that drive: global planner, controller, task."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Observation, RobotModel, Twist
from turtlebag.pipeline.conformance.answers import (
    BOOL,
    INT,
    broken,
    require_answer,
    require_attributes,
    require_twist,
    require_value,
)
from turtlebag.pipeline.conformance.trial_room import (
    HEIGHT_M,
    apart,
    bytes_of,
    made,
    require_near,
    room,
)
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver import Task
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.mission import Mission, Request
from turtlebag.pipeline.navigation.recorder import NoBag
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.planners.control.controller import Controller
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.global_plan import fits
from turtlebag.planners.planner import GlobalPlanner, NoPath, Plan, PlanConfig
from turtlebag.planners.smoothing import path_length
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import CONTROL_HZ, SimConfig, Simulator

PERIOD = 1.0 / CONTROL_HZ
AT_GOAL, DRIVE_S = (0.2, 0.35), 45.0
"""How near to the goal [m], [rad] a controller must have come after so long."""
SLACK = 1e-6
TASK_S = 6.0


def check_planner(planner: Callable[[PlanConfig], GlobalPlanner]) -> None:
    """A path round the pillar of a room, and to a place that is walled in.

    AssertionError in one line says what the contract, `turtlebag.planners.planner.GlobalPlanner`, asks.
    """
    model = load_robot("burger").model
    costmap = costmap_from_grid(room().rasterize(HEIGHT_M), CostmapConfig())
    start, goal = SE2.from_xyt(1.5, 3.0, 0.0), SE2.from_xyt(7.0, 3.5, 1.5)
    before = bytes_of(costmap.lethal, start.xyt, goal.xyt)
    plan, again = (_planned(planner, costmap, model, start, goal) for _ in range(2))
    poses = plan.poses
    if bytes_of(poses.xyt) != bytes_of(again.poses.xyt):
        raise broken(planner, "plan: the same seed must give the same bytes")
    ends = (*apart(poses[-1], goal), apart(poses[0], start)[0])
    if max(ends[0], ends[2]) > 2.0 * costmap.resolution or ends[1] > 0.05:
        raise broken(planner, "plan: the path must begin at the start and end at the goal, as it is turned")
    for k in range(len(poses)):
        if not fits(costmap, model, poses[k]):
            raise broken(planner, f"plan: the footprint touches something at pose {k}")
    steps = np.linalg.norm(np.diff(poses.xy, axis=0), axis=1)
    if steps.max() > 0.5:
        raise broken(planner, f"plan: poses {steps.max():.2f} m apart, at most 0.5 m")
    if abs(plan.length - path_length(poses.xy)) > 0.05 * plan.length:
        raise broken(planner, f"plan: length {plan.length:.2f} m of a path of {path_length(poses.xy):.2f} m")
    if plan.length > 9.0:
        raise broken(planner, f"plan: a path of {plan.length:.1f} m where 6.3 m are enough; at most 9 m")
    if bytes_of(costmap.lethal, start.xyt, goal.xyt) != before:
        raise broken(planner, "plan: must not change what it is given")
    lethal = costmap.lethal.copy()
    row, col = (int(v) for v in np.floor((costmap.T_grid_map @ goal).xy[::-1] / costmap.resolution))
    near, far = slice(row - 12, row + 13), slice(col - 12, col + 13)
    lethal[[row - 12, row + 12], far] = lethal[near, col - 12] = lethal[near, col + 12] = True
    walled = Costmap(lethal, costmap.resolution, costmap.T_map_grid)
    try:
        _planned(planner, walled, model, start, goal)
    except NoPath as error:
        if str(error).strip():
            return
    raise broken(planner, "plan: must raise NoPath with a reason where the goal is walled in")


def _planned(
    planner: Callable[[PlanConfig], GlobalPlanner], costmap: Costmap, model: RobotModel, start: SE2, goal: SE2
) -> Plan:
    one: GlobalPlanner = made(planner, GlobalPlanner, PlanConfig())
    plan = one.plan(costmap, model, start, goal, 1)
    require_answer(one, "plan", plan, Plan, poses=SE2, planner=str, length=(), margin=())
    require_value(one, "plan: poses", plan.poses.xyt, (len(plan.poses), 3))
    if len(plan.poses) < 2:
        raise broken(one, "plan: a path needs at least two poses")
    return plan


def check_controller(controller: Callable[[RobotModel, float], Controller]) -> None:
    """A path with a corner, driven by a robot that does what it is told; standing still without a path.

    AssertionError in one line says what the contract, `turtlebag.planners.control.controller.Controller`,
    asks.
    """
    model = load_robot("burger").model
    costmap = costmap_from_grid(room().rasterize(HEIGHT_M), CostmapConfig())
    legs = [np.linspace(2.0, 5.0, 61), np.full(40, 5.0)], [np.full(61, 1.0), np.linspace(1.05, 3.0, 40)]
    x, y = (np.concatenate(leg) for leg in legs)
    path = SE2(np.column_stack([x, y, np.repeat([0.0, np.pi / 2.0], [61, 40])]))
    before = bytes_of(path.xyt, costmap.lethal)
    first, again = (_driven(controller, model, path, costmap) for _ in range(2))
    if bytes_of(*first) != bytes_of(*again):
        raise broken(controller, "the same path must give the same bytes")
    if bytes_of(path.xyt, costmap.lethal) != before:
        raise broken(controller, "it must not change the path or the costmap")
    require_near(controller, f"the goal after {DRIVE_S:g} s", path[-1], SE2(first[0][-1]), AT_GOAL)
    one: Controller = made(controller, Controller, model, PERIOD)
    last = Twist(model.max_v, 0.0)
    for _ in range(round(5.0 / PERIOD)):
        command = one.brake(last)
        _require_command(one, "brake", command, last, model)
        last = command
    if abs(last.v) > 1e-3 or abs(last.w) > 1e-3:
        raise broken(controller, "brake: must come to a standstill within 5 s")
    _require_command(one, "ramp", one.ramp(Twist(9.0, 9.0), last), last, model)
    if one.command(path[0], Twist(), costmap) != Twist():
        raise broken(controller, "command: without a path the robot must stand still")


def _driven(
    controller: Callable[[RobotModel, float], Controller], model: RobotModel, path: SE2, costmap: Costmap
) -> tuple[Array, Array]:
    """Poses (n, 3) and commands (n, 2) of a drive along a path."""
    one: Controller = made(controller, Controller, model, PERIOD)
    one.set_path(path)
    pose, last, poses, commands = path[0], Twist(), [], []
    for _ in range(round(DRIVE_S / PERIOD)):
        command = one.command(pose, last, costmap)
        _require_command(one, "command", command, last, model)
        require_attributes(one, "command", one, state=str)
        turned = SE2.from_xyt(0.0, 0.0, 0.5 * command.w * PERIOD)
        pose, last = pose @ turned @ SE2.from_xyt(command.v * PERIOD, 0.0, 0.0) @ turned, command
        poses.append(pose.xyt)
        commands.append([command.v, command.w])
    return np.array(poses), np.array(commands)


def _require_command(part: object, method: str, command: Twist, last: Twist, model: RobotModel) -> None:
    """AssertionError unless it is a command that the robot can obey after the last one."""
    require_twist(part, method, command)
    _require_within(part, method, command, model)
    changes = abs(command.v - last.v) / model.max_dv, abs(command.w - last.w) / model.max_dw
    if max(changes) > PERIOD + SLACK:
        raise broken(
            part, f"{method}: from {last} to {command} is more than the robot can do in {PERIOD:.3f} s"
        )


def _require_within(part: object, method: str, command: Twist, model: RobotModel) -> None:
    if abs(command.v) > model.max_v + SLACK or abs(command.w) > model.max_w + SLACK:
        limits = f"{model.max_v} m/s, {model.max_w} rad/s"
        raise broken(part, f"{method}: {command} is beyond the robot's limits, {limits}")


def check_task(task: Callable[[Kit, Mission], Task], *, on_a_map: bool = False) -> None:
    """Some seconds of it in a room, with a second in which someone else drives.

    AssertionError in one line says what the contract, `turtlebag.pipeline.navigation.driver.Task`, asks.
    `on_a_map` gives it the map of the room.
    """
    if bytes_of(_run(task, on_a_map)) != bytes_of(_run(task, on_a_map)):
        raise broken(task, "the same seed must give the same bytes")


def _require_task(one: Task, observation: Observation, command: object) -> None:
    require_twist(one, "step", command)
    require_attributes(one, "step", one, state=str, goal_index=INT, finished=BOOL, estimate=SE2 | None)
    if one.estimate is not None:
        require_value(one, "step: estimate", one.estimate.xyt, (3,))
    if one.sensing.shown_ns != observation.stamp_ns:
        raise broken(one, "step: its sensing must get every observation")


def _run(task: Callable[[Kit, Mission], Task], on_a_map: bool) -> Array:
    """Its commands (n, 2); AssertionError where it touches something."""
    world, robot = room(), load_robot("burger")
    config = NavigateConfig(sim=SimConfig().resolved(robot))
    kit = Kit(robot, config, 1, Sensing.of(robot), NoBag())
    grid = world.rasterize(robot.lidar_height) if on_a_map else None
    costmap = None if grid is None else costmap_from_grid(grid, config.costmap)
    request = Request("a check", 1, initial_pose="start" if on_a_map else None)
    one: Task = made(task, Task, kit, Mission(request, config, robot, grid, costmap, ()))
    commands = []
    with Simulator(world, robot, config.sim, 1) as simulator:
        observation = simulator.reset()
        for k in range(round(TASK_S / PERIOD)):
            if TASK_S / 2.0 <= k * PERIOD < TASK_S / 2.0 + 1.0:
                one.stand_by(observation)
                observation = simulator.step(Twist())
                one.resume(Twist())
                continue
            command = one.step(observation)
            _require_task(one, observation, command)
            _require_within(one, "step", command, robot.model)
            commands.append([command.v, command.w])
            if one.finished:
                break
            observation = simulator.step(command)
            if simulator.truth.contact_visible:
                raise broken(one, f"touches something after {k * PERIOD:.1f} s in a room")
    return np.array(commands)
