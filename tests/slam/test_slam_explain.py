"""The explanation of a map, from a result made by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam import explain
from turtlebag.pipeline.slam.explain import loop_record, worst_edges
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.odometry.calibration import Calibration

KEYS = np.array([0, 4, 9, 15])
POSES = SE2(np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.3], [2.0, 0.2, -0.5], [2.5, 1.5, 2.0]]))


def off(i, j, shift):
    """What a match of i and j said that is wrong by a shift at the poses."""
    return (POSES[j].inverse() @ POSES[i] @ SE2(np.array(shift)).inverse()).xyt


def made():
    place = Loop(3, 0, off(3, 0, (0.3, -0.4, 0.1)), 0.5, 0.6, 0.01, np.eye(3), "accepted", violation=0.02)
    loop = Loop(2, 0, off(2, 0, (0.0, 0.05, -0.2)), 0.4, 0.7, 0.02, np.eye(3), "low overlap", gate_m=0.3)
    edges = [(0, 1, 0.1), (1, 2, 0.3), (2, 3, 0.2)]
    constraints = [
        Constraint(
            i,
            j,
            (POSES[i].inverse() @ POSES[j] @ SE2.from_xyt(-shift, 0.0, 0.0)).xyt,
            np.diag([100.0, 1, 1]),
            Kind.STEP,
        )
        for i, j, shift in edges
    ]
    unbridged = np.array([False, True, False])
    track = SimpleNamespace(
        keys=KEYS, T_track_base=SE2(np.zeros((16, 3))), source=np.zeros(16, dtype=np.int8),
        overlap=np.linspace(0.0, 1.0, 16), calibration=Calibration(),
    )  # fmt: skip
    breaks = SimpleNamespace(gaps=np.array([[3, 4], [6, 7], [10, 12]]))
    session = SimpleNamespace(track=track, breaks=breaks, graph=SimpleNamespace(unbridged=unbridged))
    check = SimpleNamespace(violations=np.array([[0, 2, 0.1], [1, 3, 0.6], [0, 3, 0.3]]))
    return SimpleNamespace(
        session=session, keys=KEYS, T_map_keys=POSES, loops=[loop], recognised=[place], track=track,
        constraints=constraints, check=check,
    )  # fmt: skip


def test_candidates_are_told_with_what_is_left_of_them_and_breaks_with_what_became_of_them():
    told = loop_record(made())
    assert told["keys"] is KEYS
    (loop,), (place,) = told["loops"], told["recognised"]
    assert (loop["i"], loop["j"], loop["gate_m"], loop["score"]) == (2, 0, 0.3, 0.4)
    assert loop["verdict"] == "low overlap"
    assert (loop["residual_m"], loop["residual_rad"]) == pytest.approx((0.05, 0.2))
    assert "violation" not in loop
    assert (place["violation"], place["overlap"], place["rmse_m"]) == (0.02, 0.6, 0.01)
    assert (place["residual_m"], place["residual_rad"]) == pytest.approx((0.5, 0.1))
    assert "gate_m" not in place
    # the steps between keys that the breaks lie in: the first, the second, the third
    assert told["breaks"] == [
        {"after_scan": 3, "before_scan": 4, "bridged": True},
        {"after_scan": 6, "before_scan": 7, "bridged": False},
        {"after_scan": 10, "before_scan": 12, "bridged": True},
    ]


def test_the_worst_edges_and_places_come_first_and_the_graph_s_moves_are_measured():
    result = made()
    edges = worst_edges(result.T_map_keys, result.constraints)
    assert [(e["i"], e["j"], e["kind"]) for e in edges] == [
        (1, 2, "step"),
        (2, 3, "step"),
        (0, 1, "step"),
    ]
    assert [e["sigmas"] for e in edges] == pytest.approx([3.0, 2.0, 1.0])
    assert worst_edges(result.T_map_keys, result.constraints, 2) == edges[:2]
    places = explain.contradicting_places(result, 2)
    assert [(p["i"], p["j"], p["violation"]) for p in places] == [(1, 3, 0.6), (0, 3, 0.3)]
    np.testing.assert_array_equal(places[0]["xy"], POSES.xy[1])
    away = np.hypot(*POSES.xy.T)
    assert explain.moved(POSES.xy) == {"mean": pytest.approx(away.mean()), "max": pytest.approx(away.max())}
    assert math.isclose(away.max(), math.hypot(2.5, 1.5))
