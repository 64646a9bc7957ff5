"""Checks of parts that map: front end, loop matcher, back end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import SE2, Array, compose
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.conformance.answers import (
    BOOL,
    INT,
    broken,
    require_answer,
    require_value,
)
from turtlebag.pipeline.conformance.trial_room import (
    LIDAR,
    apart,
    bytes_of,
    lap,
    log,
    made,
    require_information,
    require_near,
)
from turtlebag.pipeline.slam.graph.back_end import BackEnd
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.loops.matcher import LoopMatch, Stretch
from turtlebag.pipeline.slam.odometry.front_end import FrontEnd, Placed
from turtlebag.pipeline.slam.odometry.track import HYPOTHESES, Track, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Maker, Tracker
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import Clouds, make_clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits

OFF = 0.1, 0.05
"""How far off [m], [rad] a lap of a room of 8 m x 6 m may end up, scans placed one after another."""
EMPTY, GAP, BACK, HOSTILE = (12, 13), 24, 34, 40
"""Of so many scans: those without return, the first after a gap of 10 s, and one stamped before the last."""


def check_front_end(front_end: Maker, *, without_odometry: bool = True) -> None:
    """A lap of a room, with odometry and without, with scans that saw nothing, and a gap.

    AssertionError in one line says what the contract asks
    (`turtlebag.pipeline.slam.odometry.front_end.FrontEnd`). `without_odometry=False` is for those that need
    odometry.
    """
    poses = lap()
    truth = SE2(poses[0]).inverse() @ SE2(poses)
    for odometry in (True, False)[: 1 + without_odometry]:
        said = "with odometry" if odometry else "without odometry"
        recording = log(poses, odometry=odometry)
        track = _tracked(front_end, recording)
        if odometry and _bytes_of(track) != _bytes_of(_tracked(front_end, recording)):
            raise broken(front_end, "the same log must give the same bytes")
        require_information(front_end, said, track.information)
        require_near(front_end, f"a lap of a room {said}", track.T_track_base, truth, OFF)
        if len(track.keys) < 5:
            raise broken(front_end, f"{said}: it must be sure of its poses where scans fit (Placed.sure)")
        _check_hostile(front_end, recording, said)


def _bytes_of(track: Track) -> bytes:
    return bytes_of(track.T_track_base.xyt, track.information, track.overlap, track.rmse)


def _tracked(front_end: Maker, recording: Recording) -> Track:
    """What it makes of a log; AssertionError where it changes what it is given or returns no `Placed`."""
    clouds = make_clouds(recording, LIDAR.range_max)
    odometry = np.zeros(0) if recording.T_odom_base is None else recording.T_odom_base.xyt
    given = (*clouds, odometry, recording.stamps_ns)
    before = bytes_of(*given)

    tracker = Tracker(
        clouds,
        recording,
        TrackingConfig(calibration=False),
        LIDAR.range_max,
        lambda tracker: _Checked(made(front_end, FrontEnd, tracker), tracker),
    )
    for wait_s in seconds(np.diff(recording.stamps_ns)).tolist():
        tracker.step(wait_s)
    if bytes_of(*given) != before:
        raise broken(front_end, "it must not change the points, odometry or stamps that it is given")
    return tracker.track()


class _Checked(FrontEnd):
    """A front end whose every answer is looked at."""

    def __init__(self, part: FrontEnd, tracker: Tracker) -> None:
        self._part, self._tracker = part, tracker

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """As the part says; AssertionError where that is not what `Placed` describes."""
        placed = self._part.step(points, odometry_step, wait_s)
        require_answer(
            self._part, "step", placed, Placed,
            T_track_base=(3,), information=(3, 3), overlap=(), known=(), rmse=(), sure=BOOL, source=INT,
        )  # fmt: skip
        for what, most in (("overlap", 1.0), ("known", 1.0), ("rmse", np.inf)):
            if not 0.0 <= (value := getattr(placed, what)) <= most:
                raise broken(self._part, f"step: {what} is {value:g}, it must be 0 to {most:g}")
        if placed.source not in range(len(HYPOTHESES)):
            raise broken(self._part, f"step: source must be 0 to {len(HYPOTHESES) - 1}, of track.HYPOTHESES")
        for pair in placed.revised:
            if not isinstance(pair, tuple) or pair[0] not in range(self._tracker.scan):
                raise broken(self._part, "step: revised must be scans before this one, with their poses")
            require_value(self._part, "step: a revised pose", pair[1], (3,))
        return placed


def _check_hostile(front_end: Maker, recording: Recording, said: str) -> None:
    """Scans without a point, a gap, and a stamp that goes back."""
    steps = recording.T_odom_base and recording.T_odom_base[:HOSTILE]
    ranges, stamps = recording.ranges[:HOSTILE].copy(), recording.stamps_ns[:HOSTILE].copy()
    ranges[list(EMPTY)] = np.inf
    stamps[GAP:] += 10_000_000_000
    stamps[BACK] = stamps[BACK - 2]
    hostile = replace(recording, ranges=ranges, stamps_ns=stamps, T_odom_base=steps)
    track = _tracked(front_end, hostile)
    if track.information[list(EMPTY)].any():
        raise broken(front_end, f"{said}: a scan without points saw nothing: its information must be zero")
    for k in EMPTY if steps is not None else ():
        assert steps is not None
        expected = track.T_track_base[k - 1] @ (steps[k - 1].inverse() @ steps[k])
        if max(apart(expected, track.T_track_base[k])) > 1e-6:
            raise broken(front_end, f"{said}: a scan without points must be where the odometry expects it")


def check_loop_match(matcher: Callable[[], LoopMatch]) -> None:
    """Two stretches of a lap laid on each other from a start that is off, and where there is nothing.

    AssertionError in one line says what the contract asks: `turtlebag.pipeline.slam.loops.matcher.LoopMatch`.
    """
    poses = lap()
    clouds = make_clouds(log(poses, odometry=False), LIDAR.range_max)
    query, place = _stretch(poses, 60, range(54, 61)), _stretch(poses, 64, range(58, 71, 2))
    true = (SE2(poses[64]).inverse() @ SE2(poses[60])).xyt
    start = compose(true, np.array([0.1, -0.08, 0.04]))
    given = (*clouds, query.scans, query.T_about_scans, place.scans, place.T_about_scans, start, true)
    before = bytes_of(*given)
    answers = [_matched(matcher, clouds, query, place, start) for _ in range(2)]
    (pose, information, overlap), again = answers
    if bytes_of(pose, information) != bytes_of(again[0], again[1]):
        raise broken(matcher, "the same stretches must give the same bytes")
    require_information(matcher, "match", information)
    require_near(matcher, "match: from a near start", SE2(true), SE2(pose), (0.05, 0.02))
    if not 0.6 < overlap <= 1.0:
        raise broken(matcher, f"match: overlap {overlap:.2f} where all that is seen is the same; 0.6 to 1")
    one = made(matcher, LoopMatch)
    stays = one.match(clouds, query, place, start, Limits.rough()._replace(iterations=0)).T_map_base
    if max(apart(stays, SE2(start))) > 1e-6:
        raise broken(matcher, "match: with no iterations it must return the fit at the start")
    nowhere = _matched(matcher, clouds, query, place, start + np.array([60.0, 0.0, 0.0]))
    if nowhere[2] != 0.0 or nowhere[1].any():
        raise broken(matcher, "match: where nothing is seen overlap and information must be zero")
    if bytes_of(*given) != before:
        raise broken(matcher, "it must not change what it is given")


def _stretch(poses: Array, about: int, scans: range) -> Stretch:
    members = np.array(scans, dtype=np.int64)
    return Stretch(about, members, (SE2(poses[about]).inverse() @ SE2(poses[members])).xyt)


def _matched(
    matcher: Callable[[], LoopMatch], clouds: Clouds, query: Stretch, place: Stretch, start: Array
) -> tuple[Array, Array, float]:
    one = made(matcher, LoopMatch)
    found = one.match(clouds, query, place, start, Limits.rough())
    require_answer(one, "match", found, Alignment, information=(3, 3), overlap=(), known=(), rmse=())
    require_value(one, "match: T_map_base", found.T_map_base.xyt, (3,))
    return found.T_map_base.xyt, found.information, float(found.overlap)


def check_back_end(back_end: Callable[[], BackEnd]) -> None:
    """A lap of thirty poses whose steps and loop agree, then with a wrong loop.

    AssertionError in one line says what the contract, `turtlebag.pipeline.slam.graph.back_end.BackEnd`, asks.
    """
    truth = SE2(lap(30))
    start = SE2(truth.xyt + np.random.default_rng(1).normal(0.0, 0.05, (30, 3)) * [1.0, 1.0, 0.3])
    start = SE2(np.vstack([truth.xyt[:1], start.xyt[1:]]))
    information = np.diag([400.0, 400.0, 1600.0])
    pairs = [(k, k + 1) for k in range(29)] + [(0, 29), (3, 27)]
    exact = [Constraint(i, j, (truth[i].inverse() @ truth[j]).xyt, information, Kind.STEP) for i, j in pairs]
    silent = replace(exact[5], T_i_j=np.array([9.0, 0.0, 0.0]), information=np.zeros((3, 3)))
    lie = replace(exact[29], i=2, j=20, T_i_j=np.array([3.0, 0.0, 0.0]), cauchy=1.0)
    given = [start.xyt, *(c.T_i_j for c in (*exact, silent, lie)), information]
    before = bytes_of(*given)
    for graph, most, said in (
        (exact, 1e-3, "steps and loops that agree"),
        ([*exact, silent], 1e-3, "a constraint without information"),
        ([*exact, lie], 0.05, "a wrong loop under a Cauchy kernel"),
    ):
        found, again = (_optimised(back_end, start, graph) for _ in range(2))
        if bytes_of(found.xyt) != bytes_of(again.xyt):
            raise broken(back_end, "the same graph must give the same bytes")
        if max(apart(found[0], start[0])) > 1e-4:
            raise broken(back_end, "the first pose must be held")
        off = apart(found, truth)[0]
        if off > most:
            raise broken(back_end, f"{said}: {off:.3f} m off, at most {most} m")
    if bytes_of(*given) != before:
        raise broken(back_end, "it must not change what it is given")


def _optimised(back_end: Callable[[], BackEnd], start: SE2, graph: list[Constraint]) -> SE2:
    one: BackEnd = made(back_end, BackEnd)
    found = one.optimise(start, graph)
    require_answer(one, "optimise", found, SE2)
    require_value(one, "optimise: poses", found.xyt, (len(start), 3))
    return found
