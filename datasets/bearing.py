"""The bearing of a point, for kernels that ask for millions."""

from __future__ import annotations

import math

from turtlebag.datasets.kernels import njit


@njit(cache=True, forceinline=True, _nrt=False)
def bearing(y: float, x: float) -> float:
    """As `math.atan2`, to within 1.2e-10 rad, in a third of its time."""
    wide, high = abs(x), abs(y)
    short, long = min(wide, high), max(wide, high, 1e-300)
    # beyond tan(pi / 8), from the diagonal: the shorter the interval, the fewer terms
    beyond = short > 0.41421356 * long
    t = (short - long) / (short + long) if beyond else short / long
    # least largest error of an odd polynomial of the 11th degree
    t2 = t * t
    rest = 0.142241612011 - t2 * (0.104805992159 - t2 * 0.0583779902291)
    angle = t * (0.999999996271 - t2 * (0.333332711065 - t2 * (0.199970231637 - t2 * rest)))
    angle += 0.25 * math.pi if beyond else 0.0
    angle = 0.5 * math.pi - angle if high > wide else angle
    angle = math.pi - angle if x < 0.0 else angle
    return math.copysign(angle, y)
