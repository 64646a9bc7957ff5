"""Runs independent items on two threads; kernels that release the GIL run in parallel.

Items are independent and results come back in order, so they depend neither on the
number of cores nor on which thread was faster.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

THREADS = 2
# Fewer items than this are not worth a thread.
WORTH_IT = 64
Part = TypeVar("Part")


def in_parts(work: Callable[[slice], Part], n: int) -> list[Part]:
    """`work` on successive slices of n items, two at a time; its results in order."""
    if n < WORTH_IT:
        return [work(slice(0, n))]
    # more parts than threads, so that one with harder items does not keep the other thread waiting
    borders = [round(k * n / (4 * THREADS)) for k in range(4 * THREADS + 1)]
    parts = [slice(a, b) for a, b in pairwise(borders)]
    if os.environ.get("OMP_NUM_THREADS") == "1":  # others need the cores: the workers of a campaign
        return [work(part) for part in parts]
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(work, parts))
