"""Which steps of a log its loops span: a break that one spans is mended."""

import numpy as np

from turtlebag.pipeline.slam.loop_closure import _spanned
from turtlebag.pipeline.slam.loops import Loop


def loop(i: int, j: int, verdict: str) -> Loop:
    return Loop(i, j, np.zeros(3), 1.0, 1.0, 0.01, 0.3, verdict, np.eye(3))


def test_accepted_loops_span_the_steps_between_their_keys():
    record = [loop(1, 4, "accepted"), loop(7, 6, "accepted"), loop(0, 9, "rejected")]
    spanned = _spanned(record, 10)
    assert spanned.tolist() == [False, True, True, True, False, False, True, False, False]
    assert not _spanned([], 10).any()
