"""Driving again what a bag commanded: its /cmd_vel as a driver."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.outputs import sha256_text
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps, Twist
from turtlebag.sim.simulator import Truth

SUFFIXES = (".mcap", ".db3", ".bag", ".gz", ".bz2")


def is_recording(teleop: str) -> bool:
    """Whether a --teleop argument means a bag or a recording's folder."""
    return Path(teleop).is_dir() or teleop.endswith(SUFFIXES)


def replayed(path: Path) -> tuple[Generator[Twist, Truth, None], str]:
    """The /cmd_vel of any bag, in order of time, as a driver; and what config.yaml calls it: by its content,
    wherever it lies. InputError when there is none."""
    stamps, v, w = read_commands(path)
    order = np.argsort(stamps, kind="stable")
    stamps, v, w = stamps[order] - stamps[order[0]], v[order], w[order]
    content = (stamps.tolist(), v.tolist(), w.tolist())
    return _driven(stamps, v, w), f"replay:{sha256_text(repr(content))[:16]}"


def _driven(stamps: Stamps, v: Array, w: Array) -> Generator[Twist, Truth, None]:
    """Each command from its stamp on until the next; ends with the last one's."""
    truth = yield Twist()
    while truth.stamp_ns < stamps[-1]:
        now = max(int(np.searchsorted(stamps, truth.stamp_ns, side="right")) - 1, 0)
        truth = yield Twist(float(v[now]), float(w[now]))
