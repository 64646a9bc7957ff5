"""Place recognition: loops where the drift exceeds the search radius, or is unknown.

Loops by distance (`by_distance`) are searched near the estimated pose. If the track is
broken or has drifted further, submaps are recognised by appearance. A place is
accepted only if several submaps in a row agree on it (PCM), the whole stretch placed there does not violate
free space, and no other place fits nearly as well: buildings repeat themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.se2 import SE2, Array, between
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop, firm
from turtlebag.pipeline.slam.graph.drift import Drift, drift_of, reach, read_at
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig
from turtlebag.pipeline.slam.loops.consistency import agreeing_sets, competing, consistency, support
from turtlebag.pipeline.slam.loops.free_space import (
    NEAR_M,
    THROUGH_M,
    contradicts,
    mean_violation,
    thinned,
    visits,
)
from turtlebag.pipeline.slam.loops.matcher import LoopMatch, Stretch
from turtlebag.pipeline.slam.loops.submaps import (
    Pictures,
    Submap,
    farthest_m,
    laid_on,
    make_submap,
    similarity,
    windows,
)
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks
from turtlebag.pipeline.slam.odometry.track import blind
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import KeyScans
from turtlebag.pipeline.slam.scans.correspondences import Limits

# Another place may be the true one if it has at most this many times as many free-space violations (places
# that only look alike: 6 % and more, rooms identical to the centimetre 1 to 3 %). A true place has at most
# this many times what is usual in the log and what `contradicts` adds: simulated logs 0 to 1 % (0 is usual),
# CSAIL 1 (1), acapulco 2 (1.5), ACES 6 to 9 (3), a hospital 5 (9).
ALIKE_FACTOR, ALIKE_FLOOR = 2.5, 0.01
# Submaps made at one place count as one if the cosine between their headings is larger than this.
SAME_WAY = 0.7
# A submap's other scans are judged at the pose found.
AS_PUT = Limits.fine()._replace(iterations=0)


class PlaceRecognitionConfig(Settings):
    """Place recognition."""

    enabled: bool = Field(default=True, description="look for places seen before wherever they are")
    candidates: int = Field(default=12, gt=0, le=1000, description="most similar submaps to compare")
    min_overlap: float = Field(default=0.6, gt=0.0, le=1.0, description="least share of points that match")
    min_support: int = Field(default=3, gt=0, description="submaps that must agree on a place")


@dataclass(frozen=True, eq=False)
class Recognition:
    """The result: poses with the parts joined, loops, the record of all candidates, the part of the log that
    each key belongs to (keys,), and the broken steps whose scans have no weight any more (keys - 1,)."""

    T_map_keys: SE2
    loops: list[Constraint]
    record: list[Loop]
    part: NDArray[np.int64]
    released: NDArray[np.bool_]


def recognise_places(
    scans: KeyScans,
    T_map_keys: SE2,
    steps: Sequence[Constraint],
    breaks: TrackBreaks,
    known: Sequence[Constraint],
    config: PlaceRecognitionConfig,
    closing: LoopClosing,
) -> Recognition:
    """Recognise places beyond the reach of the loops by distance. `known` are those loops, `closing`
    configures their search, alignment and weight."""
    by_distance, edits, back_end = closing.config, closing.edits, closing.back_end
    poses = T_map_keys.xyt.copy()
    drift = drift_of(poses, steps, breaks.broken)
    found = _candidates(scans, drift, known, config, by_distance)
    found = [place for place in found if not edits.rejects(place.i, np.array([place.j])).any()]
    believed, record = accepted_sets(found, drift, Violations(scans, drift), config, by_distance)
    part, released = joined_parts(breaks, [(place.i, place.j) for members in believed for place in members])
    if not believed:
        return Recognition(T_map_keys, [], record, part, released)
    segment = breaks.segments()
    for members in believed:
        poses, segment = join_parts(poses, segment, members)
    loops = [by_distance.constraint(place) for members in believed for place in members]
    free = [*relaxed(steps, released), *known]
    closed = back_end.optimise(SE2(poses), [*free, *firm(loops)])
    return Recognition(back_end.optimise(closed, [*free, *loops]), loops, record, part, released)


def relaxed(steps: Sequence[Constraint], released: NDArray[np.bool_]) -> list[Constraint]:
    """The steps, without the scans over bridged breaks: such a scan fitted nothing for certain. The wheels
    stay, under their kernel: they bridge a gap as they did before it, and give way where loops contradict
    them."""
    return [
        replace(c, information=np.zeros((3, 3)))
        if c.kind is not Kind.WHEELS and c.j == c.i + 1 and released[c.i]
        else c
        for c in steps
    ]


def submap_searches(
    drift: Drift, known: Sequence[Constraint], middles: Iterable[int], reach_m: float
) -> Iterator[tuple[int, dict[int, float]]]:
    """Submaps, by their middle keys, that drift may have moved beyond the reach of the loops, each with the
    older ones that it may be at, and how far it may be off there [m].

    A place that loops have held together since is searched only once, however often it was passed.
    """
    poses = drift.T_map_keys
    ways, first_visits = drift.ways(known), list[int]()
    for i in middles:
        older = np.array(first_visits, dtype=np.int64)
        off, _ = reach(read_at(ways(i, older), poses[i]))
        apart = np.linalg.norm(poses[older, :2] - poses[i, :2], axis=1)
        same_way = np.cos(poses[older, 2] - poses[i, 2]) > SAME_WAY
        if ((apart + off < NEAR_M) & same_way).any():
            continue
        first_visits.append(i)
        far = (off > reach_m) & (apart < off + farthest_m())
        if far.any():
            yield i, dict(zip(older[far].tolist(), off[far].tolist(), strict=True))


def _candidates(
    scans: KeyScans,
    drift: Drift,
    known: Sequence[Constraint],
    config: PlaceRecognitionConfig,
    by_distance: LoopConfig,
) -> list[Loop]:
    """Every submap that is searched for, matched with the places that it resembles."""
    poses, found, matcher = drift.T_map_keys, list[Loop](), by_distance.matcher()
    places = windows(len(scans.keys), drift.broken)

    @cache
    def submap(middle: int) -> Submap | None:
        return make_submap(*scans, poses, middle, places[middle])

    for i, off in submap_searches(drift, known, places, by_distance.reach_m):
        query = submap(i)
        if query is None:
            continue
        others = [other for j in off if (other := submap(j)) is not None]
        like, pictures = similarity(query, others), Pictures()
        for k in np.argsort(-like, kind="stable")[: config.candidates].tolist():
            guess = between(poses[others[k].middle], poses[i])
            laid = laid_on(query, others[k], pictures)
            if laid is not None and np.hypot(*(laid[1] - guess)[:2]) < off[others[k].middle]:
                found.append(judge_place(scans, query, others[k], *laid, config, matcher))
    return found


def judge_place(
    scans: KeyScans,
    query: Submap,
    other: Submap,
    score: float,
    start: Array,
    config: PlaceRecognitionConfig,
    matcher: LoopMatch,
) -> Loop:
    """A coarse pose of the query relative to the other submap, refined and judged by all available checks."""
    clouds, keys = scans
    place, at_place = keys[other.keys[::2]], np.ascontiguousarray(other.T_middle_keys[::2])
    middle, there = _alone(int(keys[query.middle])), Stretch(int(keys[other.middle]), place, at_place)
    result = matcher.match(clouds, middle, there, start, Limits.rough())
    pose = result.T_map_base.xyt
    if result.overlap < config.min_overlap:  # no need to ask the other scans
        return _low_overlap(query, other, score, result)
    few, at = query.keys[::4], (SE2(pose) @ SE2(query.T_middle_keys[::4])).xyt
    overlap = 1.0
    for k, T in zip(few, at, strict=True):
        missed = 1.0 - matcher.match(clouds, _alone(int(keys[k])), there, T, AS_PUT).overlap
        overlap -= missed / len(few)
        if overlap < config.min_overlap:  # whatever the other scans say
            return _low_overlap(query, other, score, replace(result, overlap=overlap))
    both = np.vstack([at, at_place[::2]])
    pairs = np.array([*product(range(len(at)), range(len(at), len(both)))])
    violation = mean_violation(clouds, np.concatenate([keys[few], place[::2]]), both, pairs, 1.0)
    information = result.information
    verdict = "blind in one direction" if blind(information) else "candidate"
    fit = score, float(overlap), result.rmse, information
    return Loop(query.middle, other.middle, pose, *fit, verdict, violation=violation)


def _low_overlap(query: Submap, other: Submap, score: float, found: Alignment) -> Loop:
    fit = score, found.overlap, found.rmse, found.information
    return Loop(query.middle, other.middle, found.T_map_base.xyt, *fit, "low overlap", violation=1.0)


def _alone(scan: int) -> Stretch:
    return Stretch(scan, np.array([scan]), np.zeros((1, 3)))


class Violations(NamedTuple):
    """Mean free-space violations, 0..1, of visits to one place."""

    scans: KeyScans
    drift: Drift

    def usual(self) -> float:
        """Of visits between which there is little drift: people, glass."""
        poses = self.drift.T_map_keys
        # drift excludes those far apart in time; a sample holds enough of the others
        pairs = thinned(visits(poses), 10)
        off = reach(read_at(self.drift.along(*pairs.T), poses[pairs[:, 0]]))[0]
        return self._mean(poses, pairs[off < THROUGH_M], 0.0)

    def with_stretch(self, stretch: list[Loop]) -> float:
        """Of the revisits with the whole stretch placed; 1 without any. Keys move with the nearest recognised
        one, as long as drift cannot make a wall appear to be seen through."""
        n, poses = np.arange(len(self.scans.keys)), self.drift.T_map_keys
        to_i = np.array([_off(self.drift, n, place.i) for place in stretch])
        to_j = np.array([_off(self.drift, n, place.j) for place in stretch])
        newer = np.flatnonzero((to_i.min(axis=0) < THROUGH_M) & (to_i.min(axis=0) < to_j.min(axis=0)))
        older = np.flatnonzero((to_j.min(axis=0) < THROUGH_M) & (to_j.min(axis=0) <= to_i.min(axis=0)))
        moved = poses.copy()
        for k in newer.tolist():
            place = stretch[int(np.argmin(to_i[:, k]))]
            at_place = SE2(poses[place.j]) @ SE2(place.T_j_i)
            moved[k] = (at_place @ (SE2(poses[place.i]).inverse() @ SE2(poses[k]))).xyt
        near = scipy.spatial.cKDTree(moved[older, :2]).query_ball_point(moved[newer, :2], NEAR_M)
        pairs = [(newer[a], older[b]) for a, bs in enumerate(near) for b in sorted(bs)]
        return self._mean(moved, np.array(pairs, dtype=np.int64).reshape(-1, 2), 1.0)

    def _mean(self, poses: Array, pairs: NDArray[np.int64], unknown: float) -> float:
        """Of pairs (n, 2) of keys, thinned if there are many."""
        return mean_violation(*self.scans, poses, thinned(pairs), unknown)


def accepted_sets(
    found: list[Loop],
    drift: Drift,
    violations: Violations,
    config: PlaceRecognitionConfig,
    by_distance: LoopConfig,
) -> tuple[list[list[Loop]], list[Loop]]:
    """The accepted sets of places, and the record of all places with their verdicts."""
    good = [k for k, place in enumerate(found) if place.verdict == "candidate"]
    places = [found[k] for k in good]
    if not places:
        return [], list(found)
    comparable, agree = consistency(places, drift, by_distance.reach_m, by_distance.covariance_scale)
    verdicts = ["too few agree"] * len(places)
    usual = ALIKE_FACTOR * violations.usual()
    feasible: list[tuple[list[int], int, float]] = []
    for members in agreeing_sets(places, agree & comparable):
        supporters = support(places, members)
        if supporters < config.min_support - 1:
            continue
        mean = violations.with_stretch([places[k] for k in members])
        if contradicts(mean, usual):
            _mark(verdicts, members, "the stretch contradicts the place")
        else:
            feasible.append((members, supporters, mean))
    believed = []
    for members, supporters, mean in feasible:
        ambiguous = any(
            competing(members, other, comparable, agree) and their_mean <= ALIKE_FACTOR * mean + ALIKE_FLOOR
            for other, _, their_mean in feasible
            if other is not members
        )
        if ambiguous:
            _mark(verdicts, members, "ambiguous: another place fits as well")
        elif supporters >= config.min_support:
            _mark(verdicts, members, "accepted")
            believed.append([places[k] for k in members])
    record = list(found)
    for k, verdict in zip(good, verdicts, strict=True):
        record[k] = replace(found[k], verdict=verdict)
    return believed, record


def _mark(verdicts: list[str], members: list[int], verdict: str) -> None:
    for k in members:
        verdicts[k] = verdict


def _off(drift: Drift, keys: NDArray[np.int64], other: int) -> Array:
    """The uncertainty of keys (n,) relative to another one [m], (n,)."""
    gathered = drift.along(keys, np.full(len(keys), other))
    return reach(read_at(gathered, drift.T_map_keys[keys]))[0]


def joined_parts(
    breaks: TrackBreaks, joins: Sequence[tuple[int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The part of the log that each key belongs to (keys,), and the broken steps (keys - 1,) whose
    ends are connected otherwise. `joins` are pairs of keys recognised as one place. A broken step that
    nothing contradicts still connects."""
    segment = breaks.segments()
    part = np.arange(segment[-1] + 1)
    for i, j in joins:
        part[part == part[segment[i]]] = part[segment[j]]
    released = np.zeros(len(breaks.broken), dtype=bool)
    for step in np.flatnonzero(breaks.broken).tolist():
        one, two = part[segment[step]], part[segment[step + 1]]
        released[step] = one == two
        if not breaks.contradicted[step]:
            part[part == two] = one
    return np.asarray(part[segment]), released


def join_parts(poses: Array, part: NDArray[np.int64], members: list[Loop]) -> tuple[Array, NDArray[np.int64]]:
    """Poses with the newer part of a broken track moved to the accepted places, and the parts joined."""
    best = max(members, key=lambda place: place.overlap)
    newer, older = part[best.i], part[best.j]
    if newer == older:
        return poses, part
    move = SE2(poses[best.j]) @ SE2(best.T_j_i) @ SE2(poses[best.i]).inverse()
    moved = np.where((part == newer)[:, None], (move @ SE2(poses)).xyt, poses)
    return moved, np.where(part == newer, older, part)
