"""The robot's surroundings: solids that are dropped, and where the robot may stand."""

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import Solid, box
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world


def ahead(height_m: float, x: float = 0.5) -> Solid:
    """A box before the robot that stands in the origin."""
    return box("crate", (x, 0.0), (0.2, 0.2), 0.0, (0.0, height_m))


@pytest.fixture
def simulator():
    config = SimConfig.model_validate({"sensors": "clean", "lidar": {"noise": "none"}})
    with Simulator(load_world("empty"), load_robot("burger"), config, 1) as simulator:
        simulator.reset()
        yield simulator


def drive_until_touched(simulator):
    """Straight on for four seconds at most: whether what was touched is visible, and low."""
    for _ in range(120):
        simulator.step(Twist(0.2, 0.0))
        if simulator.truth.contact_visible or simulator.truth.contact_low:
            break
    return simulator.truth.contact_visible, simulator.truth.contact_low


def sweep_of(simulator):
    """Ranges of the next scan, the robot at rest."""
    for _ in range(20):
        scan = simulator.step(Twist()).scan
        if scan is not None:
            return scan.ranges
    raise AssertionError("no scan")


def test_a_dropped_solid_is_seen_from_the_next_sweep_on_and_gone_after_a_reset(simulator):
    sweep_of(simulator)
    assert not np.isfinite(sweep_of(simulator)).any()
    simulator.drop(ahead(0.5))
    sweep_of(simulator)
    assert np.isfinite(sweep_of(simulator)[0])
    assert simulator.clearance() < 0.4
    simulator.reset()
    sweep_of(simulator)
    assert not np.isfinite(sweep_of(simulator)).any()
    assert simulator.clearance() > 1.0


@pytest.mark.parametrize(("height_m", "touched"), [(0.5, (True, False)), (0.1, (False, True))])
def test_a_dropped_solid_is_touched_and_known_as_visible_or_low(simulator, height_m, touched):
    simulator.drop(ahead(height_m))
    assert drive_until_touched(simulator) == touched


def test_nothing_is_dropped_on_the_robot(simulator):
    for x in (0.0, 0.14):
        with pytest.raises(InputError, match="would touch the robot"):
            simulator.drop(ahead(0.5, x))
    assert simulator.clearance() > 1.0


def test_a_robot_may_not_stand_in_what_was_dropped_and_a_refused_reset_changes_nothing(simulator):
    simulator.drop(ahead(0.5))
    clearance = simulator.clearance()
    with pytest.raises(InputError, match=r"pose 0\.5, 0: the robot would stand in an obstacle of empty"):
        simulator.carry(SE2.from_xyt(0.5, 0.0, 0.0))
    for x, y in ((np.nan, 0.0), (900.0, 0.0)):
        with pytest.raises(InputError, match=r"start pose .* outside of world empty"):
            simulator.reset(SE2.from_xyt(x, y, 0.0))
    assert simulator.clearance() == clearance
    assert drive_until_touched(simulator) == (True, False)
