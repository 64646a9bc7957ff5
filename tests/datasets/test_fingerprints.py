"""Fingerprints: no two values run together."""

import numpy as np
import pytest

from turtlebag.datasets.fingerprints import fingerprint


def test_values_that_look_alike_have_fingerprints_of_their_own():
    values = [
        ["ab", "c"], ["a", "bc"], [["ab"], "c"], 1, 1.0, True, "1", None, [], {}, [None],
        np.zeros(2), np.zeros((2, 1)), np.zeros(2, np.float32), np.zeros(2, np.int64), -np.zeros(2),
        {"a": 1, "b": 2}, {"a": 2, "b": 1},
    ]  # fmt: skip
    assert len({fingerprint(value) for value in values}) == len(values)
    view = np.arange(12.0).reshape(3, 4).T
    assert fingerprint(view) == fingerprint(view.copy())
    with pytest.raises(TypeError, match="no fingerprint"):
        fingerprint(object())
