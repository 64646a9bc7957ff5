"""Loop closure: from the front end's track to a closed graph, by distance, then by place recognition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.constraints import Constraint, Graph, Loop, firm
from turtlebag.pipeline.slam.loops.by_appearance import PlaceRecognitionConfig, recognise_places, relaxed
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopFinder, close_loops
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks
from turtlebag.pipeline.slam.progress import Progress
from turtlebag.pipeline.slam.scans.clouds import KeyScans

# A scan that the user placed is searched within this window [m], [rad].
HAND_M, HAND_RAD = 0.5, 0.35


def close_graph(
    scans: KeyScans,
    graph: Graph,
    breaks: TrackBreaks,
    by_distance: LoopClosing,
    by_looks: PlaceRecognitionConfig,
    progress: Progress,
) -> Graph:
    """Close all loops of a track, whose graph has only its steps.

    Distance means something only within unbroken parts of the log. Places recognised beyond its reach join
    these parts and reveal the drift; keys without a loop are then searched by distance again, from there.
    Loops that the user added come first; those that the user rejected are not tried.
    """
    steps = graph.constraints
    added, T_map_keys = _added(scans, graph.T_map_keys, breaks, steps, by_distance)
    known = [by_distance.config.constraint(loop) for loop in added if loop.accepted]
    n = len(scans.keys)

    def close(start: SE2, part: NDArray[np.int64], known: list[Constraint]) -> LoopFinder:
        return close_loops(scans, start, steps, by_distance, part, known, progress)

    finder = close(T_map_keys, breaks.segments(), known)
    if not by_looks.enabled:
        record = [*added, *finder.record]
        return Graph(SE2(finder.poses), [*steps, *finder.loops], record, [], breaks.broken)
    found = recognise_places(scans, SE2(finder.poses), steps, breaks, finder.loops, by_looks, by_distance)
    record = [*added, *finder.record]
    if found.loops or breaks.broken.any():
        steps = relaxed(steps, found.released)
        record = [*added, *(loop for loop in finder.record if loop.accepted)]
        finder = close(found.T_map_keys, found.part, [*finder.loops, *found.loops])
        record += finder.record
    unbridged = breaks.broken & ~found.released & ~spanned_steps(record, n)
    return Graph(SE2(finder.poses), [*steps, *finder.loops], record, found.record, unbridged)


def _added(
    scans: KeyScans, T_map_keys: SE2, breaks: TrackBreaks, steps: list[Constraint], closing: LoopClosing
) -> tuple[list[Loop], SE2]:
    """The loops that the user added, aligned and judged like all others, and the poses with the accepted
    ones."""
    finder = LoopFinder(scans, T_map_keys, steps, closing, breaks.segments())
    added = [finder.match_from(i, j, T_j_i, HAND_M, HAND_RAD) for i, j, T_j_i in closing.edits.added]
    loops = [closing.config.constraint(loop) for loop in added if loop.accepted]
    if not loops:
        return added, T_map_keys
    roughly = closing.back_end.optimise(T_map_keys, [*steps, *firm(loops)])
    return added, closing.back_end.optimise(roughly, [*steps, *loops])


def spanned_steps(record: list[Loop], n_keys: int) -> NDArray[np.bool_]:
    """Steps that an accepted loop by distance spans, (keys - 1,)."""
    spans = np.zeros(n_keys, dtype=np.int64)
    for loop in record:
        if loop.accepted:
            spans[min(loop.i, loop.j)] += 1
            spans[max(loop.i, loop.j)] -= 1
    return np.asarray(np.cumsum(spans)[:-1] > 0)
