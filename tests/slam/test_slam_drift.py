"""Drift: the uncertainty of a key scan relative to another one, and the gates that follow from it."""

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.graph.drift import ANYWHERE, HONEST, drift_of, reach, read_at
from turtlebag.pipeline.slam.loops.consistency import consistency

SIGMA = np.array([0.02, 0.03, 0.01])


def there_and_back(n: int = 41) -> SE2:
    """A way of 0.5 m a step far from the map's origin, out and back beside itself."""
    half = n // 2
    x = 60.0 + 0.5 * np.concatenate([np.arange(half + 1), np.arange(half)[::-1]])
    y = -20.0 + np.where(np.arange(n) > half, 1.0, 0.0)
    return SE2.from_xyt(x, y, np.where(np.arange(n) > half, np.pi, 0.0))


def steps_of(T: SE2, sigma=SIGMA) -> list[Constraint]:
    told = HONEST * np.diag(np.asarray(sigma) ** -2.0)
    moves = T.steps()
    return [Constraint(k, k + 1, move, told, Kind.STEP) for k, move in enumerate(moves)]


def driven(T: SE2, n: int) -> np.ndarray:
    """Poses (n, keys, 3) as steps with that noise would have them, the first one held."""
    rng, moves = np.random.default_rng(1), T[:-1].inverse() @ T[1:]
    at, out = SE2(np.tile(T.xyt[0], (n, 1))), [np.tile(T.xyt[0], (n, 1))]
    for k in range(len(moves.xyt)):
        at = at @ moves[k] @ SE2(rng.normal(0.0, SIGMA, (n, 3)))
        out.append(at.xyt)
    return np.stack(out, axis=1)


def test_drift_is_what_noisy_steps_gather_heading_included():
    T = there_and_back()
    drift = drift_of(T.xyt, steps_of(T))
    ends = driven(T, 4000)
    for k in (5, 20, 40):
        told = read_at(drift.along(np.array([0]), np.array([k]))[0], T.xyt[k])
        apart = ends[:, k] - T.xyt[k]
        apart[:, 2] = SE2.from_array(ends[:, k]).yaw - T.yaw[k]
        apart[:, 2] = (apart[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        assert np.sqrt(np.diag(told)) == pytest.approx(apart.std(axis=0), rel=0.06)
    far, _ = reach(read_at(drift.along(np.zeros(1, dtype=int), np.array([20])), T.xyt[20]))
    # twenty turns of a hundredth, each with the lever arm that is left: more than any single step
    assert far[0] == pytest.approx(
        3.0 * np.sqrt(20 * 0.03**2 + 0.01**2 * (0.5 * np.arange(20)) @ (0.5 * np.arange(20))), rel=0.02
    )


ALL = np.arange(41)


def test_a_loop_ends_the_drift_and_a_break_makes_it_anything():
    T = there_and_back()
    steps = steps_of(T)
    drift = drift_of(T.xyt, steps)
    alone, _ = reach(read_at(drift.ways([])(40, ALL), T.xyt[40]))
    assert alone[:-1].min() > 0.0
    assert (np.diff(alone[20:]) < 0.0).all()
    assert drift.ways([])(40, ALL) == pytest.approx(drift.along(np.full(41, 40), np.arange(41)))
    loop = Constraint(0, 40, (T[0].inverse() @ T[40]).xyt, np.diag([1e6, 1e6, 1e6]), Kind.LOOP)
    closed, _ = reach(read_at(drift.ways([loop])(40, ALL), T.xyt[40]))
    assert closed[0] < 0.01
    assert (closed <= alone + 1e-9).all()
    broken = np.zeros(40, dtype=bool)
    broken[10] = True
    parted = drift_of(T.xyt, steps, broken)
    assert (parted.ways([])(40, ALL)[:11] == ANYWHERE).all()
    assert (parted.along(np.array([40]), np.array([3])) == ANYWHERE).all()
    assert parted.ways([])(40, ALL)[11:] == pytest.approx(drift.ways([])(40, ALL)[11:])


def test_between_two_loops_a_key_is_as_far_as_the_nearer_of_them_and_the_log_to_it():
    T = there_and_back()
    sure = np.diag([1e6, 1e6, 1e6])
    loops = [Constraint(j, i, (T[j].inverse() @ T[i]).xyt, sure, Kind.LOOP) for j, i in ((2, 30), (5, 36))]
    drift = drift_of(T.xyt, steps_of(T))
    ways = drift.ways(loops)
    for i, tied in ((31, 30), (34, 36), (40, 36)):
        by_log = drift.along(np.array([i]), np.array([tied]))
        assert ways(i, ALL)[:30] == pytest.approx(ways(tied, ALL)[:30] + by_log)
        since = np.arange(30 if i < 36 else 36, i + 1)
        assert ways(i, since) == pytest.approx(drift.along(np.full(len(since), i), since))


def place(i: int, j: int, T_j_i: np.ndarray) -> Loop:
    return Loop(i, j, T_j_i, 0.5, 0.8, 0.01, np.diag([0.05**-2, 0.05**-2, 0.02**-2]) * HONEST * 50.0)


@pytest.mark.slow
def test_two_places_agree_when_the_cycle_closes_as_well_as_what_it_is_made_of_is_known():
    T = there_and_back()
    track, rng = driven(T, 300), np.random.default_rng(2)
    pairs = [(36, 4), (30, 10), (38, 2)]
    told = []
    for poses in track:
        noise = rng.normal(0.0, [0.05, 0.05, 0.02], (3, 3))
        found = [
            place(i, j, (T[j].inverse() @ T[i] @ SE2(e)).xyt) for (i, j), e in zip(pairs, noise, strict=True)
        ]
        comparable, agree = consistency(found, drift_of(poses, steps_of(SE2(poses))), 4.0, 50.0)
        assert comparable[np.triu_indices(3, 1)].all()
        told.append(agree[np.triu_indices(3, 1)])
    # 3 sigmas in three dimensions
    assert np.mean(told) == pytest.approx(0.971, abs=0.02)
    drift = drift_of(T.xyt, steps_of(T))
    right = place(36, 4, (T[4].inverse() @ T[36]).xyt)
    for off, fits in (([0.1, 0.1, 0.0], True), ([1.5, 0.0, 0.0], False), ([0.0, 0.0, 0.3], False)):
        other = place(38, 2, (T[2].inverse() @ T[38] @ SE2(np.array(off))).xyt)
        comparable, agree = consistency([right, other], drift, 4.0, 50.0)
        assert comparable.all(where=~np.eye(2, dtype=bool))
        assert agree[0, 1] == agree[1, 0] == fits
    # what lies between them may be off by more than loops are looked for
    comparable, agree = consistency([right, other], drift, 0.1, 50.0)
    assert not comparable.any()
    assert agree.tolist() == [[True, False], [False, True]]
