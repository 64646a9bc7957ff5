"""Made logs with exact truth: places that a mapper must cope with."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np

from benchmarks.known_logs import Known, Mask
from tests.helpers.made_drives import Drive, FloorPlan, Lie, Sensor, Wheels, lds, make_log, points_along, sick
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.seeds import stream

WHEELS = {
    1: Wheels(0.01, 0.02, 0.001),
    2: Wheels(-0.02, -0.03, -0.003),
    3: Wheels(0.03, 0.01, 0.004, 0.008, 0.006),
}


def wheels_of(seed: int) -> Wheels:
    """The wheels of a seed: drawn with it where they are not one of WHEELS."""
    scale, turn, drift = stream(seed, "wheels").uniform(-1.0, 1.0, 3) * (0.03, 0.03, 0.004)
    return WHEELS.get(seed) or Wheels(float(scale), float(turn), float(drift))


def hall(seed: int, *, lies: tuple[Lie, ...] = (), tours: int = 2, period: float = 0.2) -> Known:
    """Two rooms joined by 30 m of corridor without a feature (seen from 8 m), there and back."""
    plan = FloorPlan(46.0, 12.0)
    plan.carve(1.0, 2.0, 7.0, 10.0)
    plan.carve(39.0, 1.0, 45.0, 8.0)
    plan.carve(7.0, 4.0, 39.0, 6.0)
    plan.pillar(3.0, 8.0, 0.3)
    plan.turned_box(42.0, 2.5, 1.2, 0.6, 0.5)
    leg = [(3.0, 3.5), (5.5, 5.0), (41.0, 5.0), (43.0, 6.5), (43.5, 4.0), (41.0, 5.0), (5.5, 5.0), (3.0, 6.5)]
    route = np.array(([*leg, (2.0, 4.0)] * tours)[:-1])
    sensor = Sensor(sick(180, 8.0), period)
    return make_log(f"hall-{seed}", plan, route, sensor, wheels=WHEELS[seed], lies=lies, seed=seed)


def office_plan(seed: int) -> FloorPlan:
    """Two corridors round a block of rooms, rooms outside as well, furniture in all; 34 x 22 m."""
    rng = stream(seed, "office plan")
    plan = FloorPlan(34.0, 22.0)
    plan.carve(6.0, 6.0, 28.0, 16.0)
    plan.box(8.0, 8.0, 26.0, 14.0)
    for x in (8.2, 12.8, 17.4, 22.0):
        for y, door in ((8.2, 8.0), (1.0, 5.85), (16.15, 16.0)):
            depth = {8.2: 5.6, 1.0: 4.85, 16.15: 4.85}[y]
            plan.carve(x, y, x + 3.6, y + depth)
            plan.carve(x + 1.4, door - 0.1, x + 2.4, door + 0.3)
            for _ in range(3):
                fx, fy = x + rng.choice([0.5, 3.1]), y + rng.uniform(0.6, depth - 0.6)
                plan.turned_box(fx, fy, rng.uniform(0.4, 0.9), rng.uniform(0.3, 0.5), rng.uniform(0.0, 3.0))
    for y in (6.5, 11.5):
        plan.carve(1.0, y, 5.85, y + 4.2)
        plan.carve(5.8, y + 1.6, 6.1, y + 2.6)
        plan.carve(28.15, y, 33.0, y + 4.2)
        plan.carve(27.9, y + 1.6, 28.2, y + 2.6)
        plan.turned_box(2.0, y + 1.0, 1.2, 0.6, rng.uniform(0.0, 3.0))
        plan.turned_box(31.5, y + 3.0, 1.2, 0.6, rng.uniform(0.0, 3.0))
    return plan


def office_route(rooms: int = 8) -> Array:
    """Round the corridors twice, into `rooms` of the rooms."""

    def visit(x: float, corridor: float, inside: float) -> list[tuple[float, float]]:
        return [(x, corridor), (x, inside), (x + 0.3, inside), (x, corridor)]

    stops = [
        [(9.0, 7.0), *visit(10.1, 7.0, 4.0), *visit(14.7, 7.0, 10.5)],
        [*visit(19.3, 7.0, 4.2), (27.0, 7.0), (27.0, 8.6), (30.0, 8.6), (30.2, 8.7), (27.0, 8.6)],
        [(27.0, 15.0), *visit(23.9, 15.0, 18.5), *visit(19.3, 15.0, 17.8)],
        [*visit(14.7, 15.0, 18.0), (7.0, 15.0), (7.0, 13.6), (4.0, 13.6), (3.9, 13.4), (7.0, 13.6)],
    ]
    lap = [point for part in stops[: max(1, rooms // 2)] for point in part]
    plain = [(7.0, 7.0), (27.0, 7.0), (27.0, 15.0), (7.0, 15.0), (7.0, 7.0), (12.0, 7.0)]
    return np.array([(9.0, 7.0), *lap, *plain])


OFFICE_SENSOR = Sensor(sick(360, 40.0), 0.2, T_base_lidar=(0.08, 0.0, 0.0))


LIES = {
    "plain": (),
    "reverse": (Lie("reverse", 20.0, 6.0), Lie("reverse", 95.0, 8.0)),
    "jump": (Lie("jump", 40.0, 0.1), Lie("jump", 150.0, 0.1)),
}
"""How the wheels lie in the office."""


def office(seed: int, lie: str = "plain") -> Known:
    """The office, with wheels that lie in one of LIES."""
    return make_log(
        f"office-{lie}-{seed}", office_plan(seed), office_route(), OFFICE_SENSOR,
        wheels=wheels_of(seed), lies=LIES[lie], seed=seed, pace=1.0,
    )  # fmt: skip


def burger_lidar(x: float = -0.032) -> Sensor:
    """TurtleBot3's lidar, with white noise alone."""
    return Sensor(lds(), 0.2, T_base_lidar=(x, 0.0, 0.0), quantum=0.0, lost=0.0, mixed=0.0)


@cache
def arena(seed: int, style: str) -> Known:
    """Nine pillars in a walled arena, TurtleBot3's lidar turning. Made once: nobody writes to it."""
    plan = FloorPlan(7.0, 7.0)
    plan.carve(1.0, 1.0, 6.0, 6.0)
    for x, y in ((1.2, 1.2), (5.8, 1.2), (1.2, 5.8), (5.8, 5.8)):
        plan.turned_box(x, y, 1.0, 1.0, 0.785)
    for x, y in product((2.4, 3.5, 4.6), repeat=2):
        plan.pillar(x, y, 0.15)
    a, b, c, d = 1.85, 2.95, 4.05, 5.15
    lap = [(b, a), (b, b), (c, b), (c, a), (d, a), (d, d), (c, d), (c, c), (b, c), (b, d), (a, d), (a, c)]
    route = [(a, a), *lap, (a, a)] * 2
    if style == "spiral":
        t = np.linspace(0.0, 1.0, 60)
        route = [(a, a), (b, a)]
        for k in range(10):
            cx, cy = ((b, b), (c, b), (c, c), (b, c))[k % 4]
            route += list(zip(cx + 0.25 * np.cos(12 * t), cy + 0.25 * np.sin(12 * t), strict=True))
    drive = {
        "slow": Drive(v=0.12, w=0.6, ahead=0.3),
        "fast": Drive(v=0.22, w=2.6, dv=2.0, dw=10.0, ahead=0.25),
        "spiral": Drive(v=0.18, w=2.0, dv=2.0, dw=10.0, ahead=0.12),
    }[style]
    sensor = burger_lidar()
    return make_log(
        f"arena-{style}-{seed}", plan, np.array(route), sensor, drive=drive, wheels=wheels_of(seed), seed=seed
    )


def rooms(seed: int) -> Known:
    """A small house for TurtleBot3: six rooms, 11 x 7.5 m, walls often beyond the lidar's 3.5 m."""
    plan = FloorPlan(13.0, 9.5)
    for x in (1.0, 4.7, 8.4):
        plan.carve(x, 1.0, x + 3.55, 3.6)
        plan.carve(x, 4.8, x + 3.55, 8.5)
        plan.carve(x + 1.2, 3.5, x + 2.1, 4.9)
    plan.carve(1.0, 3.75, 11.95, 4.65)
    for x, y, a in ((2.0, 7.6, 0.2), (6.0, 1.6, 0.9), (9.0, 7.8, 0.0), (11.2, 1.7, 0.4), (5.2, 7.9, 1.2)):
        plan.turned_box(x, y, 0.8, 0.4, a)
    route = [(2.0, 2.0)]
    for x, up in ((1.0, True), (4.7, False), (4.7, True), (8.4, False), (8.4, True), (1.0, False)):
        d, y, inside = x + 1.65, 6.0 if up else 2.5, 6.6 if up else 2.5
        route += [(d, 4.2), (d, y), (d + 0.8, inside), (d, y), (d, 4.2)]
    sensor = burger_lidar(-0.064)
    drive = Drive(v=0.22, w=1.2, ahead=0.3)
    return make_log(
        f"rooms-{seed}", plan, np.array(route), sensor, drive=drive, wheels=wheels_of(seed), seed=seed
    )


def posts(seed: int, size: float = 24.0, density: float = 0.6, radius: float = 0.02) -> Known:
    """A hall of table and chair legs, `density` a square metre: two laps with no surface in sight."""
    rng = stream(seed, "posts")
    plan = FloorPlan(size + 2.0, size + 2.0)
    plan.carve(1.0, 1.0, size + 1.0, size + 1.0)
    a, b = 6.0, size - 4.0
    lap = [(b, a), (b, b), (a, b), (a, a)]
    route = np.array([(a + 2.0, a), *lap, *lap, (a + 4.0, a)])
    driven = points_along(route, 0.1)
    placed = np.empty((0, 2))
    for xy in rng.uniform(1.3, size + 0.7, (20 * round(density * size * size), 2)):
        apart = np.linalg.norm(placed - xy, axis=1).min(initial=np.inf)
        if np.linalg.norm(driven - xy, axis=1).min() > 0.5 and apart > 0.35:
            placed = np.vstack([placed, xy])
            plan.pillar(float(xy[0]), float(xy[1]), radius)
        if len(placed) >= density * size * size:
            break
    sensor = burger_lidar()
    drive = Drive(v=0.22, w=1.0, ahead=0.3)
    return make_log(f"posts-{seed}", plan, route, sensor, drive=drive, wheels=wheels_of(seed), seed=seed)


# What is done to a log.


def interval(log: Known, start: float, length: float) -> Mask:
    """Scans of an interval [s since the first], (n,)."""
    return (log.times >= start) & (log.times < start + length)


def without(log: Known, start: float, length: float) -> Known:
    """The log with the scans of an interval missing [s since its first scan]."""
    return log.with_scans(~interval(log, start, length))


def blinded(log: Known, start: float, length: float) -> Known:
    """The log with NaN-only scans in an interval."""
    blind = interval(log, start, length)[:, None]
    return log.with_ranges(np.where(blind, np.nan, log.recording.ranges))


def clock_back(log: Known, start: float, seconds: float) -> Known:
    """The log whose clock was set back once."""
    late = log.times >= start
    return log.recorded(stamps_ns=log.recording.stamps_ns - np.where(late, round(seconds * 1e9), 0))


def shaken_stamps(log: Known, share: float, std_s: float, seed: int = 1) -> Known:
    """The log with a share of stamps wrong, so that some go backwards (as Intel's)."""
    rng, n = stream(seed, "stamps"), len(log.recording)
    wrong = np.where(rng.random(n) < share, rng.normal(0.0, std_s, n), 0.0)
    return log.recorded(stamps_ns=log.recording.stamps_ns + np.round(wrong * 1e9).astype(np.int64))
