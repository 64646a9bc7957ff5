"""How well the robot knows where it is: accuracy, models compared, speed, from nothing, kidnapped.

    python -m benchmarks.localise [accuracy] [models] [speed] [log] [global] [silent] [unseen] [kidnap]
                                  [--sensors SET] [--quick] [--limit N] [--out DIR]

Drives are simulated with drifting odometry, in the arena (burger) and the house (waffle_pi), with the
simulator's `realistic` sensors (the default) or its `clean` ones; tables lie in a folder of each. Errors are
against the truth, without alignment: position in cm, heading in degrees. The SLAM-made map is made by
`turtlebag map` from a recorded tour. `log` is the Intel log of TURTLEBAG_DATA/radish on our map of it,
against the SLAM trajectory. `global`, `silent` (the same with beams of no return dropped), `unseen`
(`global` in generated offices and mazes) and `kidnap` are episodes of 60 s, in the house where not said:
found means within 10 cm and 5 degrees at the end; `settled_s` is when the estimate became so for good. Shares
come with 95 % Wilson intervals. Every episode is a row that is kept, and is repeated by its seed; the same
command goes on where it was stopped. Times are CPU times.
"""

from __future__ import annotations

import math
import time
from argparse import Namespace
from dataclasses import replace
from functools import cache, lru_cache, partial
from pathlib import Path

import numpy as np

from benchmarks.drives import PLACES, Maps, Place, Sweep, built_map, kidnapped
from benchmarks.runner import Row, Suite, every, options, parsed, public_log, run, share
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.stages.localise import LocaliseConfig, run_amcl
from turtlebag.sim.simulator import Sensors

EPISODES = ("global", "silent", "unseen", "kidnap")
LOCALISATION = ("datasets", "pipeline/localisation", "sim", "benchmarks/drives.py", "benchmarks/localise.py")
NARROW = np.diag([0.05, 0.05, 0.05]) ** 2
FOUND_M, FOUND_RAD = 0.10, math.radians(5.0)
ROS_DEFAULTS = AmclConfig(
    sigma_hit=0.2, z_hit=0.95, z_rand=0.05, max_beams=30, min_particles=100,
    max_particles=5000, update_min_d=0.2, update_min_a=math.pi / 6, alpha1=0.2, alpha2=0.2, alpha3=0.2,
    alpha4=0.2, recovery_alpha_slow=0.0, recovery_alpha_fast=0.0, refine=False,
)  # fmt: skip
MODELS = {"default": AmclConfig(), "mean only": AmclConfig(refine=False), "ROS's numbers": ROS_DEFAULTS}


@cache
def place_of(name: str, sensors: Sensors) -> Place:
    """A place of PLACES."""
    return Place(*PLACES[name], sensors)


@lru_cache(maxsize=1)
def driven(name: str, sensors: Sensors, seed: int, seconds: float) -> list[Sweep]:
    """A drive through a place; the last one is kept at hand."""
    return place_of(name, sensors).drive(seed, seconds)


def grid_of(name: str, kind: str, sensors: Sensors, out: Path) -> OccupancyGrid:
    """The true map of a place, or the one made by SLAM."""
    if kind == "true":
        return place_of(name, sensors).grid
    return load_map(Maps(out / "maps", sensors).slam(*PLACES[name]))


def follow(amcl: Amcl, log: list[Sweep]) -> Array:
    """Position [m] and heading [rad] error after each scan, (n, 2)."""
    out = []
    for sweep in log:
        amcl.update(sweep.scan, sweep.T_odom_base, sweep.T_odom_base_end)
        error = sweep.T_world_base.inverse() @ amcl.T_map_base(sweep.T_odom_base)
        out.append((math.hypot(float(error.x), float(error.y)), abs(float(error.yaw))))
    return np.array(out)


def started(place: Place, grid: OccupancyGrid, log: list[Sweep], config: AmclConfig, seed: int) -> Amcl:
    """A filter told the true start, 5 cm and 3 degrees uncertain."""
    amcl = Amcl(grid, log[0].scan.lidar, place.robot.T_base_lidar, config, stream(seed, "amcl"))
    amcl.initialise(log[0].T_world_base, NARROW)
    return amcl


def rmse(errors: Array) -> Row:
    """Root mean squares."""
    position, heading = np.sqrt(np.mean(errors**2, axis=0))
    return {"position_cm": 100.0 * float(position), "heading_deg": math.degrees(float(heading))}


def accuracy(place: str, map: str, seed: int, model: str, sensors: Sensors, seconds: float, out: Path) -> Row:
    """A place, one of its maps, a drive, and one of MODELS."""
    log, grid = driven(place, sensors, seed, seconds), grid_of(place, map, sensors, out)
    drift = np.linalg.norm([s.T_odom_base.xy - s.T_world_base.xy for s in log], axis=1)
    amcl = started(place_of(place, sensors), grid, log, MODELS[model], seed)
    before = time.process_time()
    errors = follow(amcl, log)
    spent = 1e3 * (time.process_time() - before) / len(log)
    worst = {"max_cm": 100.0 * errors[:, 0].max(), "odometry_cm": 100.0 * math.sqrt(np.mean(drift**2))}
    return rmse(errors) | worst | {"scan_ms": spent}


def speed(place: str, sensors: Sensors) -> Row:
    """Milliseconds of a filter update with 2000 particles and 60 beams, warmed up."""
    at = place_of(place, sensors)
    log = at.drive(12, 60.0)
    amcl = started(at, at.grid, log, AmclConfig(min_particles=2000), 12)
    times = []
    for sweep in log:
        before = time.process_time()
        if amcl.update(sweep.scan, sweep.T_odom_base, sweep.T_odom_base_end):
            times.append(1e3 * (time.process_time() - before))
    median, p95 = np.percentile(times[20:], [50, 95]).tolist()
    return {"median_ms": median, "p95_ms": p95}


def intel(source: Path, *, start: str, out: Path) -> Row:
    """AMCL along a real log on our map of it, against the SLAM trajectory, by where it was told to start."""
    built = built_map(source, out / "intel_map")
    recording, slam = load_recording(source), built.trajectory.poses
    before, rng = time.process_time(), stream(1, "amcl")
    told = slam[0] if start == "told" else "global"
    found = run_amcl(recording, built.occupancy, told, LocaliseConfig(), rng).trajectory.poses
    spent = 1e3 * (time.process_time() - before) / len(recording)
    error = (slam.inverse() @ found).xyt
    off = np.hypot(error[:, 0], error[:, 1])
    middle, far = 100.0 * np.percentile(off, [50, 95])
    about = {"scans": len(recording), "median_cm": float(middle), "p95_cm": float(far)}
    about |= rmse(np.stack([off, np.abs(error[:, 2])], axis=1))
    return about | {"max_cm": 100.0 * off.max(), "within 20 cm": float(np.mean(off < 0.2)), "scan_ms": spent}


def finding(kind: str, seed: int, sensors: Sensors) -> Row:
    """An episode: whether the robot knew where it was in the end, and since when."""
    errors = episode(kind, place_of("house", sensors), seed)
    good = (errors[:, 0] < FOUND_M) & (errors[:, 1] < FOUND_RAD)
    bad = np.flatnonzero(~good)
    since = 0.2 * (int(bad[-1]) + 1) if len(bad) else 0.0
    return {"found": bool(good[-1]), "settled_s": round(since, 1)} | rmse(errors[-1:])


def episode(kind: str, place: Place, seed: int) -> Array:
    """Errors over 60 s of one episode."""
    if kind == "unseen":
        unseen = f"{('office', 'maze')[seed % 2]}:{2000 + seed // 2 % 10}"
        place = Place(unseen, "burger", place.sim.sensors)
    log = place.drive(1000 + seed, 60.0)
    config = AmclConfig()
    if kind == "kidnap":
        first = place.drive(3000 + seed, 20.0)
        amcl = started(place, place.grid, first, config, seed)
        return follow(amcl, kidnapped(first, log))[len(first) :]
    amcl = started(place, place.grid, log, config, seed)
    amcl.initialise_globally()
    if kind == "silent":
        heard = [np.where(np.isposinf(s.scan.ranges), np.nan, s.scan.ranges) for s in log]
        log = [replace(s, scan=replace(s.scan, ranges=r)) for s, r in zip(log, heard, strict=True)]
    return follow(amcl, log)


def found(rows: list[Row]) -> list[Row]:
    """How many of some episodes ended well."""
    settled = [row["settled_s"] for row in rows if "settled_s" in row] or [math.nan]
    failed = [str(row["seed"]) for row in rows if not row.get("found")]
    return [
        {
            "episode": rows[0]["kind"], "found": share(len(rows) - len(failed), len(rows)),
            "settled_s median": float(np.median(settled)), "p95": float(np.percentile(settled, 95)),
            "failed seeds": " ".join(failed),
        }
    ]  # fmt: skip


def suites(args: Namespace) -> dict[str, Suite]:
    """Tables and kinds of episodes."""
    sensors, out, log = args.sensors, args.out.absolute(), public_log("intel")
    seconds, seeds = (60.0, range(1, 3)) if args.quick else (180.0, range(1, 6))
    followed = partial(accuracy, sensors=sensors, seconds=seconds, out=out)
    maps = {"place": PLACES, "map": ("true", "slam")}
    tables = {
        "accuracy": every(followed, **maps, seed=seeds, model=("default",)),
        "models": every(followed, **maps, seed=(11,), model=MODELS),
        "speed": every(partial(speed, sensors=sensors), place=PLACES),
        "log": every(partial(intel, log, out=out), start=("told", "global")) if log is not None else [],
    }
    known = {name: Suite(cases, quick=len(cases)) for name, cases in tables.items()}
    for kind in EPISODES:
        cases = every(partial(finding, sensors=sensors), kind=(kind,), seed=range(args.limit or 100))
        known[kind] = Suite(cases, summary=found, quick=10, code=LOCALISATION, show=False)
    return known


if __name__ == "__main__":
    quick = "shorter drives, 10 episodes instead of 100"
    run(*parsed(options(__doc__, "data/benchmarks/localise", quick, sensors=True), suites))
