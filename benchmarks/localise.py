"""How well the robot knows where it is: accuracy, models compared, speed, from nothing, kidnapped.

    python -m benchmarks.localise [accuracy] [models] [speed] [log] [global] [silent] [unseen] [kidnap]
                                  [pose] [dropout] [--sensors SET ...] [--quick] [--episodes N] [--out DIR]

Drives are simulated with drifting odometry, in the arena (burger) and the house (waffle_pi), with the
simulator's `realistic` sensors (the default), its `clean` ones, or one after the other; tables lie in a
folder of each. Errors are
against the truth, without alignment: position in cm, heading in degrees. The SLAM-made map is made by
`turtlebag map` from a recorded tour. `log` is the Intel log of TURTLEBAG_DATA/radish on our map of it,
against the SLAM trajectory. `global`, `silent` (the same with beams of no return dropped), `unseen`
(`global` in generated offices and mazes), `kidnap`, `pose` (told 0.5 m and 30 degrees off) and `dropout`
(no returns for 2 s) are episodes of 60 s, in the house where not said: found means within 10 cm and 5
degrees at the end; `settled_s` is when the estimate became so for good. Shares come with 95 % Wilson
intervals. Every episode is a row of `episodes.csv` and is repeated by its seed. Times are CPU times.
"""

from __future__ import annotations

import argparse
import csv
import functools
import math
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.intervals import wilson
from benchmarks.localise_drives import Sweep, Wanderer, kidnapped
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.stages.localise import run_amcl
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.record import record
from turtlebag.sim.simulator import Sensors, SimConfig

PLACES = {"arena": ("turtlebot3_world", "burger"), "house": ("turtlebot3_house", "waffle_pi")}
TABLES = ("accuracy", "models", "speed", "log")
EPISODES = ("global", "silent", "unseen", "kidnap", "pose", "dropout")
PARTS = (*TABLES, *EPISODES)
NARROW = np.diag([0.05, 0.05, 0.05]) ** 2
FOUND_M, FOUND_RAD = 0.10, math.radians(5.0)
ROS_DEFAULTS = AmclConfig(
    sigma_hit=0.2, z_hit=0.95, z_rand=0.05, max_beams=30, min_particles=100,
    max_particles=5000, update_min_d=0.2, update_min_a=math.pi / 6, alpha1=0.2, alpha2=0.2, alpha3=0.2,
    alpha4=0.2, recovery_alpha_slow=0.0, recovery_alpha_fast=0.0, refine=False,
)  # fmt: skip
MODELS = {"default": AmclConfig(), "mean only": AmclConfig(refine=False), "ROS's numbers": ROS_DEFAULTS}


def follow(amcl: Amcl, log: list[Sweep], *, deskew: bool = True) -> Array:
    """Position [m] and heading [rad] error after each scan, (n, 2)."""
    out = []
    for sweep in log:
        amcl.update(sweep.scan, sweep.T_odom_base, sweep.T_odom_base_end if deskew else None)
        error = sweep.T_world_base.inverse() @ amcl.T_map_base(sweep.T_odom_base)
        out.append((math.hypot(float(error.x), float(error.y)), abs(float(error.yaw))))
    return np.array(out)


def started(place: Wanderer, grid: OccupancyGrid, log: list[Sweep], config: AmclConfig, seed: int) -> Amcl:
    """A filter told the true start, 5 cm and 3 degrees uncertain."""
    amcl = Amcl(grid, log[0].scan.lidar, place.robot.T_base_lidar, config, stream(seed, "amcl"))
    amcl.initialise(log[0].T_world_base, NARROW)
    return amcl


def rmse(errors: Array) -> tuple[float, float]:
    """Root mean squares in cm and degrees."""
    position, heading = np.sqrt(np.mean(errors**2, axis=0))
    return 100.0 * float(position), math.degrees(float(heading))


def accuracy(places: dict[str, Wanderer], quick: bool, out: Path) -> Iterator[list[str]]:
    """A row a place, map and drive."""
    yield ["place", "map", "seed", "odometry_cm", "position_cm", "max_cm", "heading_deg"]
    for name, place in places.items():
        grids = {"true": place.grid, "slam": slam_map(name, place.sim.sensors, out)}
        for seed in range(1, 3 if quick else 6):
            log = place.drive(seed, 60.0 if quick else 180.0)
            drift = np.linalg.norm([s.T_odom_base.xy - s.T_world_base.xy for s in log], axis=1)
            for kind, grid in grids.items():
                errors = follow(started(place, grid, log, AmclConfig(), seed), log)
                position, heading = rmse(errors)
                yield [
                    name, kind, str(seed), f"{100 * np.sqrt(np.mean(drift**2)):.1f}", f"{position:.2f}",
                    f"{100 * errors[:, 0].max():.1f}", f"{heading:.3f}",
                ]  # fmt: skip


@functools.cache
def slam_map(name: str, sensors: Sensors, out: Path) -> OccupancyGrid:
    """The map that `turtlebag map` makes of a tour recorded with these sensors."""
    world, robot = PLACES[name]
    record(world, robot, "tour", 1, out / f"{name}_record", sim=SimConfig(sensors=sensors), force=True)
    build_map(out / f"{name}_record", out / f"{name}_map", force=True)
    return load_map(out / f"{name}_map" / "map.yaml")


def models(places: dict[str, Wanderer], quick: bool, out: Path) -> Iterator[list[str]]:
    """The same drives on both maps with every model."""
    yield ["place", "map", "model", "position_cm", "heading_deg", "scan_ms"]
    for name, place in places.items():
        log = place.drive(11, 60.0 if quick else 180.0)
        cases = [(model, config, log, True) for model, config in MODELS.items()]
        cases.append(
            ("beam, product, no returns dropped", MODELS["beam, product, mean only"], deaf(log), True)
        )
        cases.append(("default, no deskewing", AmclConfig(), log, False))
        for kind, grid in {"true": place.grid, "slam": slam_map(name, place.sim.sensors, out)}.items():
            for model, config, heard, deskew in cases:
                amcl = started(place, grid, heard, config, 11)
                before = time.process_time()
                errors = follow(amcl, heard, deskew=deskew)
                spent = (time.process_time() - before) / len(log)
                position, heading = rmse(errors)
                yield [name, kind, model, f"{position:.2f}", f"{heading:.3f}", f"{1e3 * spent:.2f}"]


def deaf(log: list[Sweep]) -> list[Sweep]:
    """The drive with beams of no return dropped."""
    return [
        replace(s, scan=replace(s.scan, ranges=np.where(np.isposinf(s.scan.ranges), np.nan, s.scan.ranges)))
        for s in log
    ]


def intel(out: Path) -> Iterator[list[str]]:
    """AMCL along a real log on our map of it, against the SLAM trajectory, by where it was told to start."""
    yield [
        "start",
        "scans",
        "median_cm",
        "rmse_cm",
        "p95_cm",
        "max_cm",
        "heading_deg",
        "within 20 cm",
        "scan_ms",
    ]
    source = Path(os.environ.get("TURTLEBAG_DATA", "")) / "radish" / "intel.clf.bz2"
    if not source.is_file():
        print("log: left out (set TURTLEBAG_DATA to the folder that holds radish/intel.clf.bz2)")
        return
    if not (out / "intel_map" / "manifest.json").is_file():
        build_map(source, out / "intel_map", force=True)
    recording, grid = load_recording(source), load_map(out / "intel_map" / "map.yaml")
    slam = load_tum(out / "intel_map" / "trajectory.tum").poses
    for label, start in (("told", slam[0]), ("global", "global")):
        before = time.process_time()
        found = run_amcl(recording, grid, start, AmclConfig(), stream(1, "amcl")).trajectory.poses
        spent = 1e3 * (time.process_time() - before) / len(recording)
        error = (slam.inverse() @ found).xyt
        off = 100.0 * np.hypot(error[:, 0], error[:, 1])
        yield [
            label, str(len(recording)), f"{np.median(off):.1f}", f"{np.sqrt(np.mean(off**2)):.1f}",
            f"{np.percentile(off, 95):.1f}", f"{off.max():.1f}",
            f"{math.degrees(np.sqrt(np.mean(error[:, 2] ** 2))):.2f}", f"{np.mean(off < 20.0):.3f}",
            f"{spent:.2f}",
        ]  # fmt: skip


def speed(places: dict[str, Wanderer]) -> Iterator[list[str]]:
    """Milliseconds of a filter update with 2000 particles and 60 beams, warmed up."""
    yield ["place", "median_ms", "p95_ms", "least_ms"]
    for name, place in places.items():
        log = place.drive(12, 60.0)
        amcl = started(place, place.grid, log, AmclConfig(min_particles=2000), 12)
        times = []
        for sweep in log:
            before = time.process_time()
            if amcl.update(sweep.scan, sweep.T_odom_base, sweep.T_odom_base_end):
                times.append(1e3 * (time.process_time() - before))
        warm = np.array(times[20:])
        yield [name, f"{np.median(warm):.2f}", f"{np.percentile(warm, 95):.2f}", f"{warm.min():.2f}"]


def episode(kind: str, place: Wanderer, seed: int) -> Array:
    """Errors over 60 s of one episode."""
    if kind == "unseen":
        unseen = f"{('office', 'maze')[seed % 2]}:{2000 + seed // 2 % 10}"
        place = Wanderer(unseen, "burger", place.sim.sensors)
    log = place.drive(1000 + seed, 60.0)
    config = AmclConfig()
    if kind == "kidnap":
        first = place.drive(3000 + seed, 20.0)
        amcl = started(place, place.grid, first, config, seed)
        return follow(amcl, kidnapped(first, log))[len(first) :]
    amcl = started(place, place.grid, log, config, seed)
    if kind in ("global", "silent", "unseen"):
        amcl.initialise_globally()
    if kind == "silent":
        log = deaf(log)
    if kind == "pose":
        way = stream(seed, "wrong pose").uniform(-math.pi, math.pi)
        side = 1.0 if seed % 2 else -1.0
        start = log[0].T_world_base
        amcl.initialise(
            SE2.from_xyt(
                start.x + 0.5 * math.cos(way), start.y + 0.5 * math.sin(way), start.yaw + side * math.pi / 6
            )
        )
    if kind == "dropout":
        blind = np.full(log[0].scan.lidar.n_beams, np.inf, dtype=np.float32)
        log[50:60] = [replace(s, scan=replace(s.scan, ranges=blind)) for s in log[50:60]]
    return follow(amcl, log)


def episodes(kinds: list[str], place: Wanderer, count: int, out: Path) -> Iterator[list[str]]:
    """A row a kind; every episode goes to episodes.csv."""
    yield ["episode", "n", "found", "share_%", "interval_%", "settled_s median", "p95", "failed seeds"]
    with (out / "episodes.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["kind", "seed", "found", "settled_s", "position_m", "heading_rad"])
        for kind in kinds:
            settled, failed = [], []
            for seed in range(count):
                errors = episode(kind, place, seed)
                good = (errors[:, 0] < FOUND_M) & (errors[:, 1] < FOUND_RAD)
                bad = np.flatnonzero(~good)
                since = 0.2 * (bad[-1] + 1) if len(bad) else 0.0
                rows.writerow([kind, seed, int(good[-1]), f"{since:.1f}", *(f"{e:.4f}" for e in errors[-1])])
                settled.append(since)
                failed += [] if good[-1] else [seed]
            ok = count - len(failed)
            low, high = wilson(ok, count)
            yield [
                kind, str(count), str(ok), f"{100 * ok / count:.0f}", f"{100 * low:.1f}..{100 * high:.1f}",
                f"{np.median(settled):.1f}", f"{np.percentile(settled, 95):.1f}", " ".join(map(str, failed)),
            ]  # fmt: skip


def show(name: str, table: Iterator[list[str]], out: Path) -> None:
    """Print a table as it grows and write it as CSV."""
    print(f"\n{name}", flush=True)
    with (out / f"{name}.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        for row in table:
            rows.writerow(row)
            print(
                "  ".join(f"{cell:<22}" if i < 2 else f"{cell:>11}" for i, cell in enumerate(row)), flush=True
            )


def main() -> None:
    """Print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--sensors", nargs="+", choices=["realistic", "clean"], default=["realistic"])
    parser.add_argument("--quick", action="store_true", help="shorter drives, 10 episodes instead of 100")
    parser.add_argument("--episodes", type=int, metavar="N", help="episodes of each kind (default: 100)")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks/localise"))
    arguments = parser.parse_args()
    parts = arguments.parts or list(PARTS)
    if unknown := set(parts) - set(PARTS):
        parser.error(f"unknown part {', '.join(sorted(unknown))}")
    for sensors in arguments.sensors:
        print(f"\nsensors: {sensors}")
        measure(parts, sensors, arguments)


def measure(parts: Sequence[str], sensors: Sensors, arguments: argparse.Namespace) -> None:
    """The tables asked for, with one set of sensors."""
    out, quick = arguments.out / sensors, arguments.quick
    out.mkdir(parents=True, exist_ok=True)
    places = {name: Wanderer(*names, sensors) for name, names in PLACES.items()}
    if "accuracy" in parts:
        show("accuracy", accuracy(places, quick, out), out)
    if "models" in parts:
        show("models", models(places, quick, out), out)
    if "speed" in parts:
        show("speed", speed(places), out)
    if "log" in parts:
        show("log", intel(out), out)
    if kinds := [part for part in EPISODES if part in parts]:
        count = arguments.episodes or (10 if quick else 100)
        show("finding", episodes(kinds, places["house"], count, out), out)


if __name__ == "__main__":
    main()
