"""What `turtlebag identify` finds of robots whose parameters it is not told.

python -m benchmarks.twin [SUITE ...] [--robots N] [--out DIR]

Suites:
  coverage       robots with drawn parameters, three minutes each in a house, an office and a maze: how often
                 the 95 % intervals hold the true number, and the median error
  observability  drives that cannot show some parameters: straight ahead only, on the spot only, and without
                 /cmd_vel and IMU: how often these are called not observable, and the others of a whole drive
                 observable
  real           public logs (TURTLEBAG_DATA): errors of odometry, front end and mapper by the relations, and
                 those of the twin by its truth, at the same pairs of scans; the truth gets such errors as
                 the log's relations have, by how far those of three scans do not close
  round_trip     robots with drawn parameters beside twins of one bag of theirs, four minutes in a maze: do
                 the errors of mapping and localisation of its first half minute tell 20 drives of each apart
  power          the same robots beside some with 10 % more noise (4 drives) or slip (16): do ranges and
                 odometry tell them apart
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import ks_2samp

from benchmarks.runner import Row, Suite, each, every, options, parsed, public_log, run, share
from benchmarks.slam_scores import own_errors
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import Relations, load_relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.pipeline.identify.identify import Identification, Streams, identify
from turtlebag.pipeline.identify.identify import identified as identified_by
from turtlebag.pipeline.slam.graph.edits import Edits
from turtlebag.pipeline.slam.mapper import SlamConfig, SlamResult, run_slam
from turtlebag.pipeline.stages.localise import LocaliseConfig, aligned_in_time, run_amcl
from turtlebag.pipeline.stages.map import map_scans
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.pipeline.stages.twin import driven_again, write_twin
from turtlebag.pipeline.twin.comparison import cliffs_delta, compare, holm
from turtlebag.pipeline.twin.driver import Drive
from turtlebag.pipeline.twin.samples import Samples, odometry_samples, range_samples
from turtlebag.reports.metrics.relations import nearest, relations_metrics
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world

CODE = ("sim", "pipeline/slam", "pipeline/identify", "pipeline/twin", "datasets", "benchmarks/twin.py")
PLACES = {"house": "turtlebot3_house", "office": "office:{}", "maze": "maze:{}"}
WAY_M, DRIVES = 30.0, 20
LOOKED_DRIVES = {"noise": 4, "slip": 16, "none": 16}
ARENA, LOGS = "turtlebot3_world", ("mit-csail", "aces", "fr079", "intel")
# Scans of a twin are as near as this [ns] to those of its log; what is driven again of a drive [ns].
NEAR_NS, BEGUN_NS = 150_000_000, 30_000_000_000
SYSTEMS = ("odometry", "front end", "mapper")
LOOKED_AT = ("residual_0", "residual_1", "residual_2", "wander", "turn")
SCRIPTS: dict[str, list[dict[str, Any]]] = {
    "drive": [{"wait": 2.0}, {"random_walk": WAY_M}, {"wait": 1.0}],
    "straight": [{"wait": 1.0}, {"drive": 1.2}, {"wait": 0.5}, {"drive": -1.2}] * 2,
    "short": [{"wait": 1.0}, {"random_walk": 7.0}],
    "spin": [{"wait": 1.0}, {"turn_deg": 360.0}, {"turn_deg": -360.0}] * 2,
}
HIDDEN = {
    "straight": (
        "turn_scale", "turn_slip", "lidar_x", "lidar_y", "gyro_scale", "sweep", "first_beam", "max_dw",
    ),
    "spin": ("wheel_scale", "turn_per_m", "lidar_yaw", "slip", "max_dv"),
    "bare": (
        "command_delay", "max_dv", "max_dw", "gyro_scale", "gyro_bias", "gyro_noise", "accelerometer_noise",
    ),
}  # fmt: skip
"""What a drive cannot show; `bare` is a whole one without /cmd_vel and IMU."""
SHOWN = (
    "wheel_scale", "turn_scale", "turn_per_m", "slip", "lidar_x", "lidar_y", "lidar_yaw", "sigma", "lost",
    "rate", "odometry_delay", "gyro_scale", "gyro_noise", "accelerometer_noise",
)  # fmt: skip
"""What every whole drive shows."""


def hidden_robot(seed: int) -> RobotSpec:
    """A burger whose parameters are drawn."""
    rng, burger = stream(seed, "hidden robot"), load_robot("burger")

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def factor(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    scale, turn_scale, first = between(0.97, 1.03), between(0.95, 1.05), between(0.002, 0.02)
    wheels = {
        "controller_radius": burger.wheels.radius / scale,
        "separation": 2.0 * burger.wheels.joint_y * turn_scale / scale,
        "turn_per_m": between(-0.03, 0.03),
        "calibration_error": 0.0,
        "slip": factor(5e-4, 3e-3),
        "turn_slip": factor(3e-3, 2e-2),
    }
    errors = {
        "sigma": factor(2e-3, 1e-2), "sigma_square": factor(1e-3, 5e-3), "angle_deg": between(0.05, 0.2),
        "resolution": float(rng.choice([0.00025, 0.001])), "jitter": between(0.001, 0.005), "speed": 0.01,
        "stamp_delay": (first, first + between(0.002, 0.01)), "offset": 0.0, "square": 0.0,
        "known_offset": between(-0.01, 0.01), "known_square": between(-0.002, 0.002),
        "lost": factor(0.005, 0.1), "grazing": between(0.05, 0.2),
    }  # fmt: skip
    x, y, yaw = burger.lidar.pose
    pose = (x + between(-0.03, 0.03), y + between(-0.03, 0.03), yaw + between(-0.05, 0.05))
    limits = {
        "command_delay": int(rng.integers(0, 7)) / 30.0,
        "max_dv": factor(0.3, 1.5), "max_dw": factor(2.0, 10.0),
        "wheel_acceleration": 10.0,
    }  # fmt: skip
    imu = {
        "gyro_noise": factor(1e-4, 2e-3),
        "gyro_bias": 2e-3,
        "gyro_walk": 1e-6,
        "accelerometer_noise": factor(5e-3, 5e-2),
    }
    lidar = burger.lidar.model_copy(
        update={
            "pose": pose, "sweep": between(0.6, 1.0),
            "errors": type(burger.lidar.errors).model_validate(burger.lidar.errors.model_dump() | errors),
        }
    )  # fmt: skip
    parts = {"wheels": wheels, "limits": limits, "imu": imu}
    changed = {name: getattr(burger, name).model_copy(update=to) for name, to in parts.items()}
    return burger.model_copy(update={**changed, "lidar": lidar})


def truth_of(robot: RobotSpec, seed: int) -> dict[str, float]:
    """The numbers that identify estimates, of a robot in a run of this seed."""
    wheels, lidar, errors = robot.wheels, robot.lidar, robot.lidar.errors
    draws = np.clip(stream(seed, "lidar").standard_normal(4), -3.0, 3.0)
    scale = wheels.radius / (wheels.controller_radius or wheels.radius)
    late = float(np.mean(errors.stamp_delay))
    own = (
        "sigma", "sigma_square", "angle_deg", "resolution", "jitter", "lost", "grazing", "known_offset",
        "known_square",
    )  # fmt: skip
    return {
        "wheel_scale": scale,
        "turn_scale": scale * wheels.separation / (2.0 * wheels.joint_y),
        "turn_per_m": wheels.turn_per_m,
        **{name: float(getattr(wheels, name)) for name in ("slip", "turn_slip")},
        **dict(zip(("lidar_x", "lidar_y", "lidar_yaw"), lidar.pose, strict=True)),
        **{name: float(getattr(errors, name)) for name in own},
        "sweep": lidar.sweep,
        "rate": lidar.rate_hz * (1.0 + errors.speed * float(draws[3])),
        "odometry_delay": -late, "stamp_delay": late,
        "late_spread": errors.stamp_delay[1] - errors.stamp_delay[0],
        **{name: float(getattr(robot.limits, name)) for name in ("command_delay", "max_dv", "max_dw")},
        "gyro_scale": 1.0,
        "gyro_bias": robot.imu.gyro_bias * float(stream(seed, "imu").standard_normal(6)[2]),
        "gyro_noise": robot.imu.gyro_noise, "accelerometer_noise": robot.imu.accelerometer_noise,
    }  # fmt: skip


def identified(place: str, seed: int, script: str, robot: RobotSpec, *, bare: bool = False) -> Identification:
    """A robot's identification by such a drive; the lidar is said to sit where the burger's does."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "rec"
        driven(out, robot, script, seed, PLACES[place].format(1000 + seed))
        recording = load_recording(out, T_base_lidar=load_robot("burger").T_base_lidar)
        streams = Streams() if bare else Streams.of(out)
        return identify(replace(recording, imu=None) if bare else recording, load_robot("burger"), streams)


def coverage(place: str, seed: int) -> Row:
    """Each parameter: true, estimated, ends of the interval, and whether it is called observable."""
    robot = hidden_robot(1000 * [*PLACES].index(place) + seed)
    found, true = identified(place, seed, "drive", robot), truth_of(robot, seed)
    return {
        name: [value, found[name].value, *found[name].interval_95, found[name].observable]
        for name, value in true.items()
    }


def held(rows: list[Row]) -> list[Row]:
    """A row a parameter: how often the interval holds it, the median error and the median half interval."""
    table = []
    names = [name for name in rows[0] if isinstance(rows[0][name], list)] if rows else []
    for name in names:
        shown = [row[name] for row in rows if isinstance(row.get(name), list) and row[name][4]]
        inside = sum(low - 1e-9 <= true <= high + 1e-9 for true, _, low, high, _ in shown)
        off = [abs(value - true) for true, value, *_ in shown]
        half = [0.5 * (high - low) for _, _, low, high, _ in shown]
        middle = (f"{np.median(one):.2g}" if one else "" for one in (off, half))
        table.append(
            {
                "parameter": name,
                "in the interval": share(inside, len(shown)),
                "observable": f"{len(shown)} of {len(rows)}",
            }
            | dict(zip(("median error", "half an interval"), middle, strict=True))
        )
    return table


def observability(place: str, seed: int, drive: str) -> Row:
    """What is called otherwise than it is: observable though hidden, or the other way round."""
    bare = drive == "bare"
    robot = hidden_robot(5000 + seed)
    found = identified(place, seed, "drive" if bare else drive, robot, bare=bare)
    wrong = [name for name in HIDDEN[drive] if found[name].observable]
    asked = len(HIDDEN[drive])
    if bare:
        shown = [name for name in SHOWN if name not in HIDDEN[drive]]
        wrong += [name for name in shown if not found[name].observable]
        asked += len(shown)
    return {"asked": asked, "wrong": wrong}


def right(rows: list[Row]) -> list[Row]:
    """How often a parameter is called what it is."""
    asked, wrong = sum(row.get("asked", 0) for row in rows), sum(len(row.get("wrong", ())) for row in rows)
    return [{"called what they are": share(asked - wrong, asked)}]


def real(log: str) -> Row:
    """Mean errors of the relations [m]: of the log, and of its twin by its truth; of the relations alone."""
    path, config = public_log(log), SlamConfig()
    if path is None:
        return {}
    recording, relations = load_recording(path), load_relations(path.with_name(f"{log}.relations"))
    with tempfile.TemporaryDirectory() as folder:
        mapped, found, drive, world = twin_in(Path(folder), recording, path)
        again, truth = driven_again(world, found.robot, drive, 1)
    start = int(drive.path.stamps_ns[0])
    stamps = relations.stamps_a_ns, relations.stamps_b_ns
    ends = [nearest(truth.stamps_ns + start, at, NEAR_NS) for at in stamps]
    a, b = (rows[ends[0][1] & ends[1][1]] for rows, _ in ends)
    off = own_errors(relations)
    errors = stream(1, "relations").choice(off, len(a)) * stream(1, "signs").choice([-1.0, 1.0], (len(a), 1))
    T_a_b = truth.poses[a].inverse() @ truth.poses[b] @ SE2(errors)
    same = Relations(truth.stamps_ns[a], truth.stamps_ns[b], T_a_b)
    real_ones = by_system(recording, mapped, relations)
    twins = by_system(again, run_slam(again, config), same)
    ratios = {name: [real_ones[name], twins[name], twins[name] / real_ones[name]] for name in twins}
    return {**ratios, "relations": float(np.hypot(*off[:, :2].T).mean())}


def twin_in(
    folder: Path, recording: Recording, source: Path
) -> tuple[SlamResult, Identification, Drive, World]:
    """The map, the robot, the drive and the world of a recording, written to a folder."""
    mapped = map_scans([recording], SlamConfig(), None, Edits(), explain=False)
    result = mapped.result
    assert isinstance(result, SlamResult)
    found = identified_by(recording, result.session, load_robot("burger"), Streams.of(source))
    drive = write_twin(mapped, found, Drive.of(result.trajectory, None), folder, source)
    return result, found, drive, load_world(str(folder / "world.yaml"))


def by_system(recording: Recording, found: SlamResult, relations: Relations) -> dict[str, float]:
    """Errors [m] of the odometry, the front end and the whole."""
    assert recording.T_odom_base is not None
    poses = recording.T_odom_base, found.session.track.T_track_base, found.trajectory.poses
    errors = [relations_metrics(Trajectory(recording.stamps_ns, own), relations) for own in poses]
    means = [float(one["relations"]["trans_m"]["mean"] or 0.0) for one in errors]
    return dict(zip(SYSTEMS, means, strict=True))


def round_trip(robot: int) -> Row:
    """Errors [m] of a robot and of its twins, a drive a row; p after Holm, and Cliff's delta."""
    hidden, maze = hidden_robot(7000 + robot), PLACES["maze"].format(7000 + robot)
    with tempfile.TemporaryDirectory() as folder:
        bag, place = Path(folder) / "rec", Path(folder) / "twin"
        path = driven(bag, hidden, "drive", robot, maze)
        recording = load_recording(bag, T_base_lidar=load_robot("burger").T_base_lidar)
        place.mkdir()
        _, found, drive, world = twin_in(place, recording, bag)
        samples = []
        for of_twin in (False, True):
            errors = []
            for seed in range(DRIVES):
                spec = found.drawn(stream(seed, "round trip")) if of_twin else hidden
                way = begun(drive if of_twin else Drive(path))
                again, truth = driven_again(world if of_twin else load_world(maze), spec, way, seed)
                errors.append(drive_errors(again, truth, seed))
            samples.append({name: np.array([one[name] for one in errors]) for name in errors[0]})
    p = holm(np.array([ks_2samp(samples[0][name], samples[1][name]).pvalue for name in samples[0]]))
    return {
        name: [float(np.median(samples[0][name])), float(np.median(samples[1][name])), float(p[k]),
               cliffs_delta(samples[0][name], samples[1][name])]
        for k, name in enumerate(samples[0])
    }  # fmt: skip


def begun(drive: Drive) -> Drive:
    """The first half minute of a drive."""
    path = drive.path
    first = path.stamps_ns <= path.stamps_ns[0] + BEGUN_NS
    return Drive(Trajectory(path.stamps_ns[first], path.poses[first]))


def drive_errors(recording: Recording, truth: Trajectory, seed: int) -> dict[str, float]:
    """Root mean squares after a fit [m]: of the drive's own map, and of the localisation on it."""
    mapped, recording = run_slam(recording, SlamConfig()), aligned_in_time(recording)
    start = mapped.trajectory.poses[0]
    localised = run_amcl(recording, mapped.grid, start, LocaliseConfig(), stream(seed, "amcl"))
    paths = {"mapping": mapped.trajectory, "localisation": localised.trajectory}
    errors = {name: associate(path, truth).aligned().position_errors() for name, path in paths.items()}
    return {name: float(np.sqrt(np.mean(one**2))) for name, one in errors.items()}


def driven(out: Path, robot: RobotSpec, script: str, seed: int, place: str = ARENA) -> Trajectory:
    """Record a drive; its true path."""
    scene = Scene.load(place, "burger", seed)
    scene = replace(scene, robot=robot, sim=type(scene.sim)().resolved(robot))
    with tempfile.TemporaryDirectory() as folder:
        teleop = Path(folder) / "script.yaml"
        teleop.write_text(yaml.safe_dump({"name": script, "v": 0.2, "w": 0.8, "steps": SCRIPTS[script]}))
        record(scene, str(teleop), Output(out))
    return load_tum(out / "truth" / "trajectory.tum")


def power(robot: int) -> Row:
    """Whether a tenth more noise, or slip, is told apart from the robot itself, and nothing else is."""
    hidden, arena = hidden_robot(7000 + robot), load_world(ARENA)
    with tempfile.TemporaryDirectory() as folder:
        drive = Drive(driven(Path(folder) / "rec", hidden, "short", robot))
    errors, wheels = hidden.lidar.errors, hidden.wheels
    more = {"sigma": 1.1 * errors.sigma, "sigma_square": 1.1 * errors.sigma_square}
    noisy = hidden.lidar.model_copy(update={"errors": errors.model_copy(update=more)})
    slips = {"slip": 1.1 * (wheels.slip or 0.0), "turn_slip": 1.1 * (wheels.turn_slip or 0.0)}
    robots = {
        "noise": hidden.model_copy(update={"lidar": noisy}),
        "slip": hidden.model_copy(update={"wheels": wheels.model_copy(update=slips)}),
        "none": hidden,
    }

    def pooled(spec: RobotSpec, first: int, count: int) -> Samples:
        drives = [driven_again(arena, spec, drive, first + seed) for seed in range(count)]
        each = [range_samples(own) | odometry_samples(own, truth.poses) for own, truth in drives]
        return {name: np.concatenate([one[name] for one in each]) for name in each[0] if name in LOOKED_AT}

    itself = pooled(hidden, 0, max(LOOKED_DRIVES.values()))
    found = {name: compare(itself, [pooled(spec, 100, LOOKED_DRIVES[name])]) for name, spec in robots.items()}
    return {name: [one.quantity.name for one in ones if one.differs] for name, ones in found.items()}


def ratios(rows: list[Row]) -> list[Row]:
    """Real, twin and their ratio, a row a log."""
    texts = [
        {name: " / ".join(f"{one:.3g}" for one in row.get(name, ())) for name in SYSTEMS} for row in rows
    ]
    return [
        {"log": row["log"]} | text | {"relations": row.get("relations")}
        for row, text in zip(rows, texts, strict=True)
    ]


def passed(rows: list[Row]) -> list[Row]:
    """How many robots' errors cannot be told from those of their twins."""
    names, rows = ("mapping", "localisation"), [row for row in rows if "error" not in row]
    alike = sum(all(row[name][2] >= 0.05 for name in names) for row in rows)
    table = [{"robots": "all", "not told apart": share(alike, len(rows))} | dict.fromkeys(names, "")]
    for row in rows:
        texts = {name: "{:.4f} / {:.4f} m, p {:.2g}, delta {:+.2f}".format(*row[name]) for name in names}
        table.append({"robots": row["robot"]} | texts)
    return table


def told(rows: list[Row]) -> list[Row]:
    """How many changes are told apart by what they are seen in, and by anything where nothing changed."""
    noise = sum(any(name.startswith("residual") for name in row["noise"]) for row in rows)
    slip = sum(any(name in ("wander", "turn") for name in row["slip"]) for row in rows)
    counts = {"noise": noise, "slip": slip, "none": sum(bool(row["none"]) for row in rows)}
    return [{name: share(count, len(rows)) for name, count in counts.items()}]


def suites(args: Namespace) -> dict[str, Suite]:
    """All suites."""
    per_place = range(501, 501 + -(-args.robots // len(PLACES)))
    rows = [(place, seed) for seed in per_place for place in PLACES]
    drives = every(observability, place=("house", "office"), seed=(201, 202), drive=HIDDEN)
    return {
        "coverage": Suite(
            each(coverage, ("place", "seed"), rows), summary=held, quick=3, code=CODE, show=False
        ),
        "observability": Suite(drives, summary=right, quick=3, code=CODE),
        "real": Suite(every(real, log=LOGS), summary=ratios, quick=1, code=CODE),
        "round_trip": Suite(every(round_trip, robot=range(10)), summary=passed, quick=1, code=CODE),
        "power": Suite(every(power, robot=range(10)), summary=told, quick=1, code=CODE),
    }


if __name__ == "__main__":
    quick = "three robots instead of all"
    run(*parsed(options(__doc__, "data/benchmarks/twin", quick, robots=30), suites))
