"""Whom key scans are compared with, in places that were visited often."""

import numpy as np
import pytest

from tests.helpers.slam_rooms import random_poses
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.marginals import factorised, laplacian
from turtlebag.pipeline.slam.graph.partners import CROWD, earlier_in_place, overlapping_pairs
from turtlebag.pipeline.slam.loops.free_space import visits

LAP = 40


def laps(count: int) -> np.ndarray:
    """Key scans of a robot that goes round and round, (count * LAP, 3)."""
    angle = np.tile(np.linspace(0.0, 2.0 * np.pi, LAP, endpoint=False), count)
    noise = np.random.default_rng(1).normal(0.0, 0.03, (len(angle), 3))
    return np.column_stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), angle + 0.5 * np.pi]) + noise


def test_the_earlier_ones_of_a_place_are_counted_in_order():
    poses = np.array([[0.1, 0.1, 0.1], [0.3, 0.4, 0.7], [0.1, 0.1, 0.9], [0.6, 0.1, 0.1], [0.2, 0.2, 0.0]])
    assert earlier_in_place(poses).tolist() == [0, 1, 0, 0, 2]
    poses = random_poses(300, 4, std=1.0)
    place = np.floor(poses / [0.5, 0.5, 0.25 * np.pi])
    by_hand = [int((place[:k] == place[k]).all(axis=1).sum()) for k in range(len(poses))]
    assert earlier_in_place(poses).tolist() == by_hand


def test_later_visits_to_a_crowded_place_have_partners_among_the_first_alone():
    poses = laps(60)
    earlier, pairs = earlier_in_place(poses), overlapping_pairs(SE2(poses))
    late = earlier >= CROWD
    assert 0.4 < late.mean() < 0.9
    apart = pairs[:, 1] - pairs[:, 0] > 2
    of_late = pairs[apart & late[pairs].any(axis=1)]
    assert (earlier[of_late].min(axis=1) == 0).all()
    assert np.bincount(of_late[late[of_late]], minlength=len(poses))[late].min() >= 3


@pytest.mark.parametrize("of", ["factor", "revisits"])
def test_what_a_key_scan_costs_does_not_grow_with_the_visits(of):
    def costs(count: int) -> float:
        poses = laps(count)
        if of == "revisits":
            return len(visits(poses)) / len(poses)
        i, j = overlapping_pairs(SE2(poses)).T
        held = laplacian(len(poses), i, j, np.tile(np.eye(3), (len(i), 1, 1)))[3:, 3:]
        return factorised(held).L.nnz / len(poses)

    assert costs(80) < 1.1 * costs(40)
