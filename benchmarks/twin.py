"""What `turtlebag identify` finds of robots whose parameters it is not told.

python -m benchmarks.twin [SUITE ...] [--robots N] [--out DIR]

Suites:
  coverage       robots with drawn parameters, three minutes each in a house, an office and a maze: how often
                 the 95 % intervals hold the true number, and the median error
  observability  drives that cannot show some parameters: straight ahead only, on the spot only, and without
                 /cmd_vel and IMU: how often these are called not observable, and the others of a whole drive
                 observable
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.runner import Row, Suite, each, every, options, parsed, run, share
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.identify.identify import Identification, Streams, identify
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.sim.robots import RobotSpec, load_robot

CODE = ("sim", "pipeline/slam", "pipeline/identify", "datasets", "benchmarks/twin.py")
PLACES = {"house": "turtlebot3_house", "office": "office:{}", "maze": "maze:{}"}
WAY_M = 30.0
SCRIPTS: dict[str, list[dict[str, Any]]] = {
    "drive": [{"wait": 2.0}, {"random_walk": WAY_M}, {"wait": 1.0}],
    "straight": [{"wait": 1.0}, {"drive": 1.2}, {"wait": 0.5}, {"drive": -1.2}] * 2,
    "spin": [{"wait": 1.0}, {"turn_deg": 360.0}, {"turn_deg": -360.0}] * 2,
}
HIDDEN = {
    "straight": (
        "turn_scale",
        "turn_slip",
        "lidar_x",
        "lidar_y",
        "gyro_scale",
        "sweep",
        "first_beam",
        "max_dw",
    ),
    "spin": ("wheel_scale", "turn_per_m", "lidar_yaw", "slip", "max_dv"),
    "bare": (
        "command_delay",
        "max_dv",
        "max_dw",
        "gyro_scale",
        "gyro_bias",
        "gyro_noise",
        "accelerometer_noise",
    ),
}
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
        "sigma",
        "sigma_square",
        "angle_deg",
        "resolution",
        "jitter",
        "lost",
        "grazing",
        "known_offset",
        "known_square",
    )
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
    scene = Scene.load(PLACES[place].format(1000 + seed), "burger", seed)
    scene = replace(scene, robot=robot, sim=type(scene.sim)().resolved(robot))
    with tempfile.TemporaryDirectory() as folder:
        teleop, out = Path(folder) / "script.yaml", Path(folder) / "rec"
        teleop.write_text(yaml.safe_dump({"name": script, "v": 0.2, "w": 0.8, "steps": SCRIPTS[script]}))
        record(scene, str(teleop), Output(out))
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


def suites(args: Namespace) -> dict[str, Suite]:
    """Both suites."""
    per_place = range(201, 201 + -(-args.robots // len(PLACES)))
    rows = [(place, seed) for seed in per_place for place in PLACES]
    drives = every(partial(observability), place=("house", "office"), seed=(201, 202), drive=HIDDEN)
    return {
        "coverage": Suite(
            each(coverage, ("place", "seed"), rows), summary=held, quick=3, code=CODE, show=False
        ),
        "observability": Suite(drives, summary=right, quick=3, code=CODE),
    }


if __name__ == "__main__":
    quick = "three robots instead of all"
    run(*parsed(options(__doc__, "data/benchmarks/twin", quick, robots=30), suites))
