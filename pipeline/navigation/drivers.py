"""Builds the driver of each task from its components."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.global_search import global_search
from turtlebag.pipeline.localisation.localisers import make_localiser
from turtlebag.pipeline.localisation.pose_hypotheses import Aliasing
from turtlebag.pipeline.navigation.avoid_driver import AvoidDriver
from turtlebag.pipeline.navigation.explore_driver import ExploreDriver
from turtlebag.pipeline.navigation.goal_states import Machine, State
from turtlebag.pipeline.navigation.guarded_avoidance import GuardedAvoidance
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.pose_watch import PoseWatch
from turtlebag.pipeline.navigation.relocalisation import Relocaliser
from turtlebag.planners.control.goal_checker import PASSING
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.planners.rolling_costmap import RollingLayer
from turtlebag.planners.tasks.patrol import GoalSequence

# Without a map: cells of the window, how far off its centre the robot may be (not measured); plans keep
# farther off: with the distance of plans on a map BARN 1011 ran into a wall.
WINDOW_CELL_M, WINDOW_SHIFT_M, MAPLESS_INFLATION_M = 0.05, 1.0, 0.6


def make_navigator(
    kit: Kit, grid: OccupancyGrid, costmap: Costmap, sequence: GoalSequence, state: State = State.WAIT
) -> NavigationDriver:
    """A driver on a map, whose localiser is not yet initialised."""
    config, robot = kit.config, kit.robot
    lidar, *others = kit.lidars()
    parts = grid, lidar.spec, lidar.T_base_lidar, config.amcl
    amcl = make_localiser(config.localiser, *parts, stream(kit.seed, "amcl"), others)
    localiser = OnlineLocaliser(amcl, kit.sensing.odometry, kit.publisher)
    tools = kit.tools(ObstacleLayer(costmap))
    search = amcl.search if isinstance(amcl, Amcl) else global_search(grid, lidar.spec, config.amcl)
    memory = ObstacleMemory(robot.model)
    # The stream's name is part of the seed: another name would be other random numbers.
    aliasing = Aliasing(search, stream(kit.seed, "rivals"))
    relocaliser = Relocaliser(
        PoseWatch(config.relocalise, Machine(state)),
        localiser,
        aliasing,
        tools,
        GuardedAvoidance(robot.model, memory),
    )
    return NavigationDriver(tools, kit.sensing, sequence, memory, relocaliser)


def make_mapless(kit: Kit, T_odom_base: SE2, sequence: GoalSequence) -> NavigationDriver:
    """A mapless driver, by odometry and scans alone; goals are in the odometry frame."""
    m = kit.config.mapless
    plan = kit.config.plan.model_copy(update={"inflation_radius": MAPLESS_INFLATION_M})
    own = {"controller": m.controller, "recovery": m.recovery, "plan": plan}
    config = kit.config.model_copy(update=own)
    window = RollingLayer(T_odom_base.xy, m.window, WINDOW_CELL_M, WINDOW_SHIFT_M)
    tools, memory = kit.tools(window, config), ObstacleMemory(kit.robot.model)
    return NavigationDriver(tools, kit.sensing, sequence, memory)


def make_explorer(kit: Kit, online: OnlineMap, end_s: float) -> ExploreDriver:
    """A driver that maps what it can reach, until a stamp at the latest [s]."""
    config = kit.config.model_copy(update={"goal_checker": PASSING})
    one_cell = np.zeros((1, 1), dtype=np.bool_)  # before anything was mapped
    tools = kit.tools(ObstacleLayer(Costmap(one_cell, 1.0, SE2.identity())), config)
    return ExploreDriver(config.costmap, kit.sensing, online, tools, end_s)


def make_avoider(kit: Kit, end_s: float, say: Callable[[str], None]) -> AvoidDriver:
    """A driver that avoids obstacles, until a stamp [s]; `say` receives each decision."""
    return AvoidDriver(kit.config.avoid, kit.robot.model, kit.sensing, end_s, say)
