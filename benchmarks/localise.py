"""How well the robot knows where it is: accuracy, models compared, speed, from nothing, kidnapped.

    python -m benchmarks.localise [accuracy] [models] [speed] [log] [global] [silent] [unseen] [kidnap]
                                  [--sensors SET ...] [--quick] [--episodes N] [--out DIR]

Drives are simulated with drifting odometry, in the arena (burger) and the house (waffle_pi), with the
simulator's `realistic` sensors (the default), its `clean` ones, or one after the other; tables lie in a
folder of each. Errors are
against the truth, without alignment: position in cm, heading in degrees. The SLAM-made map is made by
`turtlebag map` from a recorded tour. `log` is the Intel log of TURTLEBAG_DATA/radish on our map of it,
against the SLAM trajectory. `global`, `silent` (the same with beams of no return dropped), `unseen`
(`global` in generated offices and mazes) and `kidnap` are episodes of 60 s, in the house where not said:
found means within 10 cm and 5 degrees at the end; `settled_s` is when the estimate became so for good. Shares
come with 95 % Wilson intervals. Every episode is a row of `episodes.jsonl` and is repeated by its seed; the
same command goes on where it was stopped. Times are CPU times.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.drives import INTEL, PLACES, Maps, Place, Sweep, built_map, kidnapped
from benchmarks.runner import Row, Rows, options, parts_of, public, share, write
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
NARROW = np.diag([0.05, 0.05, 0.05]) ** 2
FOUND_M, FOUND_RAD = 0.10, math.radians(5.0)
ROS_DEFAULTS = AmclConfig(
    sigma_hit=0.2, z_hit=0.95, z_rand=0.05, max_beams=30, min_particles=100,
    max_particles=5000, update_min_d=0.2, update_min_a=math.pi / 6, alpha1=0.2, alpha2=0.2, alpha3=0.2,
    alpha4=0.2, recovery_alpha_slow=0.0, recovery_alpha_fast=0.0, refine=False,
)  # fmt: skip
MODELS = {"default": AmclConfig(), "mean only": AmclConfig(refine=False), "ROS's numbers": ROS_DEFAULTS}


class Session:
    """One set of sensors: its places, their maps, and where tables go."""

    def __init__(self, sensors: Sensors, out: Path, quick: bool) -> None:
        self.out, self.seconds, self.quick = out, 60.0 if quick else 180.0, quick
        self.places = {name: Place(*names, sensors) for name, names in PLACES.items()}
        self._maps = Maps(out / "maps", sensors)

    def grids(self, name: str) -> dict[str, OccupancyGrid]:
        """The true map of a place, and the one made by SLAM."""
        return {"true": self.places[name].grid, "slam": load_map(self._maps.slam(*PLACES[name]))}


def follow(amcl: Amcl, log: list[Sweep], *, deskew: bool = True) -> Array:
    """Position [m] and heading [rad] error after each scan, (n, 2)."""
    out = []
    for sweep in log:
        amcl.update(sweep.scan, sweep.T_odom_base, sweep.T_odom_base_end if deskew else None)
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


def accuracy(session: Session) -> Iterator[Row]:
    """A row a place, map and drive."""
    for name, place in session.places.items():
        for seed in range(1, 3 if session.quick else 6):
            log = place.drive(seed, session.seconds)
            drift = np.linalg.norm([s.T_odom_base.xy - s.T_world_base.xy for s in log], axis=1)
            for kind, grid in session.grids(name).items():
                errors = follow(started(place, grid, log, AmclConfig(), seed), log)
                about = {"place": name, "map": kind, "seed": seed, "max_cm": 100.0 * errors[:, 0].max()}
                yield about | rmse(errors) | {"odometry_cm": 100.0 * math.sqrt(np.mean(drift**2))}


def models(session: Session) -> Iterator[Row]:
    """The same drives on both maps with every model."""
    cases = [(model, config, True) for model, config in MODELS.items()]
    for name, place in session.places.items():
        log = place.drive(11, session.seconds)
        for kind, grid in session.grids(name).items():
            for model, config, deskew in [*cases, ("default, no deskewing", AmclConfig(), False)]:
                amcl = started(place, grid, log, config, 11)
                before = time.process_time()
                errors = follow(amcl, log, deskew=deskew)
                spent = (time.process_time() - before) / len(log)
                yield {"place": name, "map": kind, "model": model} | rmse(errors) | {"scan_ms": 1e3 * spent}


def intel(session: Session) -> Iterator[Row]:
    """AMCL along a real log on our map of it, against the SLAM trajectory, by where it was told to start."""
    if (source := public(*INTEL)) is None:
        print("log: left out (set TURTLEBAG_DATA to the folder that holds radish/intel.clf.bz2)")
        return
    built = built_map(source, session.out / "intel_map")
    recording, grid, slam = load_recording(source), built.occupancy, built.trajectory.poses
    for label, start in (("told", slam[0]), ("global", "global")):
        before = time.process_time()
        found = run_amcl(recording, grid, start, LocaliseConfig(), stream(1, "amcl")).trajectory.poses
        spent = 1e3 * (time.process_time() - before) / len(recording)
        error = (slam.inverse() @ found).xyt
        off = np.hypot(error[:, 0], error[:, 1])
        middle, far = 100.0 * np.percentile(off, [50, 95])
        about = {"start": label, "scans": len(recording), "median_cm": float(middle), "p95_cm": float(far)}
        about |= rmse(np.stack([off, np.abs(error[:, 2])], axis=1))
        yield about | {"max_cm": 100.0 * off.max(), "within 20 cm": np.mean(off < 0.2), "scan_ms": spent}


def speed(session: Session) -> Iterator[Row]:
    """Milliseconds of a filter update with 2000 particles and 60 beams, warmed up."""
    for name, place in session.places.items():
        log = place.drive(12, 60.0)
        amcl = started(place, place.grid, log, AmclConfig(min_particles=2000), 12)
        times = []
        for sweep in log:
            before = time.process_time()
            if amcl.update(sweep.scan, sweep.T_odom_base, sweep.T_odom_base_end):
                times.append(1e3 * (time.process_time() - before))
        median, p95, least = np.percentile(times[20:], [50, 95, 0]).tolist()
        yield {"place": name, "median_ms": median, "p95_ms": p95, "least_ms": least}


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


def finding(kinds: list[str], place: Place, count: int, out: Path) -> Iterator[Row]:
    """A row a kind; every episode is a row of its own."""
    rows = Rows(out / "episodes.jsonl")
    for kind in kinds:
        found = []
        for seed in range(count):
            row = rows.get(f"{kind} {seed}")
            if row is None:
                errors = episode(kind, place, seed)
                good = (errors[:, 0] < FOUND_M) & (errors[:, 1] < FOUND_RAD)
                bad = np.flatnonzero(~good)
                since = 0.2 * (int(bad[-1]) + 1) if len(bad) else 0.0
                figures = {"seed": seed, "found": bool(good[-1]), "settled_s": round(since, 1)}
                row = rows.add(f"{kind} {seed}", figures | rmse(errors[-1:]))
            found.append(row)
        settled = [row["settled_s"] for row in found]
        yield {
            "episode": kind, "found": share(sum(row["found"] for row in found), count),
            "settled_s median": float(np.median(settled)), "p95": float(np.percentile(settled, 95)),
            "failed seeds": " ".join(str(row["seed"]) for row in found if not row["found"]),
        }  # fmt: skip


TABLES: dict[str, Callable[[Session], Iterator[Row]]] = {
    "accuracy": accuracy, "models": models, "speed": speed, "log": intel
}  # fmt: skip


def main() -> None:
    """Print and write the tables."""
    parser = options(__doc__, "data/benchmarks/localise", "shorter drives, 10 episodes instead of 100")
    parts_of(parser, (*TABLES, *EPISODES))
    parser.add_argument("--sensors", nargs="+", choices=get_args(Sensors), default=["realistic"])
    parser.add_argument("--episodes", type=int, metavar="N", help="episodes of each kind (default: 100)")
    args = parser.parse_args()
    for sensors in args.sensors:
        session = Session(sensors, args.out / sensors, args.quick)
        for name in [name for name in TABLES if name in args.parts]:
            write(session.out, name, list(TABLES[name](session)))
        if kinds := [part for part in EPISODES if part in args.parts]:
            count = args.episodes or (10 if args.quick else 100)
            write(session.out, "finding", list(finding(kinds, session.places["house"], count, session.out)))


if __name__ == "__main__":
    main()
