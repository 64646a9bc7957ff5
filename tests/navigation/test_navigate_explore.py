"""The start of an exploration of the arena: it drives, its map grows, it touches nothing."""

import dataclasses

import numpy as np
import pytest

from turtlebag.datasets.grid import FREE
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.drivers import make_explorer
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.recorder import NoBag
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world


def explorer(duration_s, **replaced):
    robot, config = load_robot("burger"), NavigateConfig()
    kit = Kit(robot, config, 1, Sensing(robot.T_base_lidar), NoBag())
    driver = make_explorer(kit, OnlineMap(robot.T_base_lidar, config.explore.slam), duration_s)
    driver.tools = dataclasses.replace(driver.tools, **replaced)
    return robot, driver


@pytest.mark.slow
def test_exploring_widens_the_map_without_a_contact():
    robot, driver = explorer(9.0)
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
    robot, driver = explorer(1.0)
    silent = SimConfig.model_validate({"faults": {"scan_loss": 1.0}})
    with Simulator(load_world("turtlebot3_world"), robot, silent, 1) as simulator:
        observation = simulator.reset()
        while not driver.finished and observation.stamp_ns < 2e9:
            observation = simulator.step(driver.step(observation))
    assert driver.finished
    assert driver.grid is None


class Holding:
    """A collision monitor that lets nothing pass but standing still."""

    def limit(self, wanted, points_base):
        return float(wanted.v == 0.0 and wanted.w == 0.0)

    def limit_on_map(self, wanted, clearance, resolution, x, y, yaw):
        return 1.0


@pytest.mark.slow
def test_a_held_robot_climbs_its_recoveries_instead_of_choosing_anew_for_ever():
    robot, driver = explorer(60.0, monitor=Holding())
    places = []
    with Simulator(load_world("turtlebot3_world"), robot, SimConfig(), 1) as simulator:
        observation = simulator.reset()
        while observation.stamp_ns < 35e9:
            observation = simulator.step(driver.step(observation))
            if driver.state.startswith("recover"):
                places.append((driver.goal_index, driver.state))
    # wait 2 s, clear 0.3 s, back up (not possible: wait 2 s), wait 4 s: all for one place
    assert len({index for index, _ in places}) == 1
    assert len([state for _, state in places if state == "recover_wait"]) > 7.5 * 30
