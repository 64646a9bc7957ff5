"""The numbers of p_bad, fitted to the half `build` of the rows of benchmarks.coverage, and how good they are.

    python -m benchmarks.p_bad [--out DIR]

A logistic regression with weights from 0 to MOST_WEIGHT, normally distributed about PRIOR beforehand: a term
that hardly ever came stays there. The threshold is the lowest that keeps false alarms of this half below
ALARMS. Prints what goes into pipeline/slam/check/p_bad.py, and the detection of both halves with it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from benchmarks.coverage import judged
from benchmarks.runner import Row, options, rows_file, share
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.check.p_bad import MOST, WEIGHTS

MOST_WEIGHT, RIDGE, ALARMS = 5.0, 0.3, 0.03
PRIOR = {"contradicted": 3.0, "scans": 2.0, "motion": 4.0, "uncertain": 1.5, "thick": 2.0}


def features(rows: Sequence[Row]) -> Array:
    """Sizes of the terms of maps, (n, terms)."""
    return np.array([[min(row["check"]["terms"].get(name, 0.0), MOST) for name in WEIGHTS] for row in rows])


def fitted(X: Array, bad: NDArray[np.bool_]) -> tuple[float, Array]:
    """Base and weights of the likeliest model for terms (n, k) of maps that are `bad` (n,)."""
    prior = np.array([PRIOR[name] for name in WEIGHTS])

    def loss(w: Array) -> float:
        odds = w[0] + X @ w[1:]
        likelihood = np.logaddexp(0.0, np.where(bad, -odds, odds)).sum()
        return float(likelihood + RIDGE * np.square(w[1:] - prior).sum())

    bounds = [(-8.0, 0.0)] + [(0.0, MOST_WEIGHT)] * X.shape[1]
    w = scipy.optimize.minimize(loss, [-3.0, *prior], bounds=bounds, method="L-BFGS-B").x
    return float(w[0]), w[1:]


def threshold(p: Array, bad: NDArray[np.bool_]) -> float:
    """The lowest probability from on which at most ALARMS of the good maps are called doubtful."""
    return float(np.quantile(p[~bad], 1.0 - ALARMS))


def main() -> None:
    """Fit and print."""
    args = options(__doc__, "data/benchmarks/coverage").parse_args()
    rows = []
    for suite in ("maps", "disturbed"):
        file = rows_file(args.out, suite)
        rows += [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    rows = [row for row in judged(list({row["case"]: row for row in rows}.values())) if "bad" in row]
    build = [row for row in rows if row["half"] == "build"]
    bad = np.array([row["bad"] for row in build])
    base, weights = fitted(features(build), bad)
    p = 1.0 / (1.0 + np.exp(-base - features(build) @ weights))
    limit = threshold(p, bad)
    print(f"BASE = {base:.2f}")
    print("\n".join(f"{name}: {weight:.2f}" for name, weight in zip(WEIGHTS, weights, strict=True)))
    print(f"DOUBTFUL = {limit:.3f}")
    for half in ("build", "score"):
        part = [row for row in rows if row["half"] == half]
        if not part:
            continue
        is_bad = np.array([row["bad"] for row in part])
        called = 1.0 / (1.0 + np.exp(-base - features(part) @ weights)) >= limit
        missed = share(int((is_bad & ~called).sum()), int(is_bad.sum()))
        alarms = share(int((~is_bad & called).sum()), int((~is_bad).sum()))
        print(f"{half}: missed {missed} bad ones, false alarms {alarms}")


if __name__ == "__main__":
    main()
