"""The start of an exploration of the arena: it drives, its map grows, it touches nothing."""

import numpy as np

from datasets.grid import FREE
from pipeline.navigation.config import NavigateConfig
from pipeline.navigation.explore import ExploreConfig, ExploreDriver
from pipeline.navigation.online_map import OnlineMap
from pipeline.navigation.recorder import NoBag
from pipeline.navigation.sensing import Sensing
from pipeline.navigation.setup import make_tools
from planners.live import LiveLayer
from sim.robots import load_robot
from sim.simulator import SimConfig, Simulator
from sim.worlds import load_world


def test_exploring_widens_the_map_without_a_contact():
    robot, explore = load_robot("burger"), ExploreConfig()
    config = NavigateConfig(goal_checker=explore.checker)
    online = OnlineMap(robot.T_base_lidar, explore.slam)
    driver = ExploreDriver(
        explore,
        robot.model,
        Sensing(robot.T_base_lidar),
        online,
        lambda costmap: make_tools(robot, config, LiveLayer(costmap, config.live)),
        NoBag(),
        duration_s=9.0,
        seed=1,
    )
    seen, contacts = [], 0
    with Simulator(load_world("turtlebot3_world"), robot, SimConfig(), 1) as simulator:
        observation = simulator.reset()
        while not driver.finished and observation.stamp_ns < 15e9:
            observation = simulator.step(driver.step(observation))
            contacts += simulator.truth.contact_visible
            if driver.grid is not None and (not seen or seen[-1] is not driver.grid):
                seen.append(driver.grid)
        true = simulator.truth.T_world_base
    assert driver.finished
    assert contacts == 0
    areas = [int(np.count_nonzero(grid.cells == FREE)) for grid in seen]
    assert areas[-1] > 1.1 * areas[0]
    assert np.linalg.norm(true.xy - [-2.0, -0.5]) > 0.5
    error = true.inverse() @ driver.estimate
    assert np.hypot(error.x, error.y) < 0.05


def test_exploring_ends_in_time_when_no_scan_ever_comes():
    robot, explore = load_robot("burger"), ExploreConfig()
    silent = SimConfig.model_validate({"faults": {"scan_loss": 1.0}})
    online, sensing = OnlineMap(robot.T_base_lidar, explore.slam), Sensing(robot.T_base_lidar)
    driver = ExploreDriver(
        explore, robot.model, sensing, online, lambda costmap: None, NoBag(), duration_s=1.0, seed=1
    )
    with Simulator(load_world("turtlebot3_world"), robot, silent, 1) as simulator:
        observation = simulator.reset()
        while not driver.finished and observation.stamp_ns < 2e9:
            observation = simulator.step(driver.step(observation))
    assert driver.finished
    assert driver.grid is None
