import math

import numpy as np
import pytest

from turtlebag.datasets.types import LidarSpec, Scan, Twist
from turtlebag.planners.tasks.sector_rule import Sectors, decision_line, read_sectors, tutorial_rule

LDS = LidarSpec(360, 0.0, math.pi / 180.0, 0.12, 3.5)


def scan_with(values: dict[int, float]) -> Scan:
    ranges = np.full(360, np.inf, dtype=np.float32)
    for degree, value in values.items():
        ranges[degree] = value
    return Scan(0, ranges, LDS)


@pytest.mark.parametrize(
    ("degree", "sector"),
    [
        *[(d, "front") for d in (0, 30, 330, 359)],
        *[(d, "left") for d in (60, 90, 120)],
        *[(d, "right") for d in (240, 270, 300)],
        *[(d, None) for d in (31, 59, 121, 180, 239, 301, 329)],
    ],
)
def test_each_beam_belongs_to_its_sector(degree, sector):
    found = read_sectors(scan_with({degree: 0.7}))
    near = {name for name in ("left", "front", "right") if getattr(found, name) < 1.0}
    assert near == ({sector} if sector else set())


def test_invalid_ranges_are_ignored():
    found = read_sectors(scan_with({0: math.nan, 5: -math.inf, 10: 0.005, 15: 0.9, 90: math.inf}))
    assert found.front == pytest.approx(0.9)
    assert found.left == math.inf


@pytest.mark.parametrize(
    ("front", "left", "right", "expected"),
    [
        (0.49, 2.0, 1.0, Twist(0.0, 0.5)),
        (0.49, 1.0, 2.0, Twist(0.0, -0.5)),
        (0.49, 1.0, 1.0, Twist(0.0, -0.5)),
        (0.49, math.inf, math.inf, Twist(0.0, -0.5)),
        (0.5, 2.0, 1.0, Twist(0.1, 0.3)),
        (1.0, 1.0, 2.0, Twist(0.1, -0.3)),
        (1.0, 1.0, 1.0, Twist(0.1, -0.3)),
        (1.01, 0.2, 0.2, Twist(0.2, 0.0)),
        (math.inf, 0.2, 3.0, Twist(0.2, 0.0)),
    ],
)
def test_the_three_tiers(front, left, right, expected):
    assert tutorial_rule(Sectors(left, front, right)).command == expected


def test_the_line_says_what_was_seen_and_decided():
    sectors = Sectors(0.75, 0.4, math.inf)
    line = decision_line(1.2, sectors, tutorial_rule(sectors))
    words = ["1.2", "s", "left", "0.75", "front", "0.40", "right", "inf", "stop,", "turn", "right"]
    assert line.split() == words
