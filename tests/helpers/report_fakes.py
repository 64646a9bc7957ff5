"""Small stage outputs with the contract's files, made without simulating anything."""

import json
from contextlib import contextmanager
from pathlib import Path

import matplotlib.figure
import numpy as np
import pytest

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import map_files, save_map
from turtlebag.datasets.outputs import sha256_file, write_json, write_manifest
from turtlebag.datasets.runlog import Row, RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.trajectories import load_tum, save_tum
from turtlebag.datasets.types import Joints, LidarSpec, Observation, Odometry, Scan, Trajectory, Twist
from turtlebag.reports.metrics.map import map_metrics
from turtlebag.reports.metrics.navigation import pose_error
from turtlebag.reports.metrics.trajectory import ate, trajectory_metrics

TICK_NS = 1_000_000_000 // 30
TICKS = 900
LIDAR = LidarSpec(4, 0.0, np.pi / 2, 0.12, 3.5)
GOALS = ((1.3, 0.6), (-1.3, 0.6), (0.0, -1.2))
"""Where the fake robot is after each third of its ellipse."""


def true_room(world: str = "room") -> OccupancyGrid:
    """Solid walls around 6 x 4.8 m with a block in the middle; other worlds have a second block."""
    cells = np.full((108, 132), OCCUPIED, dtype=np.int8)
    cells[6:-6, 6:-6] = FREE
    cells[48:60, 58:74] = OCCUPIED
    if world != "room":
        cells[10:14, 10:14] = OCCUPIED
    return OccupancyGrid(cells, 0.05, SE2.from_xyt(-3.3, -2.7, 0.0))


def mapped_room() -> OccupancyGrid:
    """The room's skin as a good SLAM would map it, one corner a little off."""
    cells = np.full((108, 132), UNKNOWN, dtype=np.int8)
    cells[5:-5, 5:-5] = OCCUPIED
    cells[6:-6, 6:-6] = FREE
    cells[48:60, 58:74] = OCCUPIED
    cells[49:59, 59:73] = UNKNOWN
    cells[6:20, 7] = OCCUPIED
    return OccupancyGrid(cells, 0.05, SE2.from_xyt(-3.3, -2.7, 0.0))


def ellipse(world: str = "room") -> SE2:
    start = -np.pi / 2 if world == "room" else 0.0
    angle = start + np.linspace(0.0, 2.0 * np.pi, TICKS)
    return SE2.from_xyt(1.5 * np.cos(angle), 1.2 * np.sin(angle), angle + np.pi / 2)


def drifting(truth: SE2) -> SE2:
    """Odometry that turns a little too far, from the same start."""
    step = truth[:-1].inverse() @ truth[1:]
    pose, poses = truth[0], [truth[0]]
    for k in range(len(step)):
        pose = pose @ SE2.from_xyt(1.01 * step.x[k], step.y[k], step.yaw[k] + 2e-4)
        poses.append(pose)
    return SE2.stack(poses)


def write_bag(
    folder: Path, *, particles: bool, world: str = "room", goals: tuple = GOALS
) -> tuple[np.ndarray, SE2, SE2]:
    stamps = np.arange(TICKS, dtype=np.int64) * TICK_NS
    truth = ellipse(world)
    odometry = drifting(truth)
    rng = stream(1, "fake particles")
    with BagWriter(folder, custom={"seed": "1"}) as bag:
        for k in range(TICKS):
            stamp, twist = int(stamps[k]), Twist(0.2, 0.1)
            joints = Joints(stamp, (0.0, 0.0), (0.0, 0.0))
            scan = Scan(stamp, np.ones(4, dtype=np.float32), LIDAR) if k % 6 == 0 else None
            bag.observation(Observation(stamp, Odometry(stamp, odometry[k], twist), joints, scan))
            bag.truth(stamp, truth[k], twist)
            bag.command(stamp, twist)
            if particles and k % 300 == 0:
                bag.goal(stamp, SE2.from_xyt(*goals[k // 300], 0.0))
            if particles and k % 30 == 0:
                std = 0.4 * np.exp(-k / 150.0) + 0.02
                bag.particles(stamp, SE2.from_array(truth[k].xyt + rng.normal(scale=std, size=(200, 3))))
    return stamps, truth, odometry


def write_truth(folder: Path, stamps: np.ndarray, truth: SE2, world: str = "room") -> None:
    (folder / "truth").mkdir()
    save_tum(Trajectory(stamps[::6], truth[::6]), folder / "truth/trajectory.tum")
    save_map(true_room(world), folder / "truth")


def noisy(trajectory: Trajectory, sigma: float) -> Trajectory:
    noise = stream(2, "fake noise").normal(scale=sigma, size=trajectory.poses.xyt.shape)
    return Trajectory(trajectory.stamps_ns, SE2.from_array(trajectory.poses.xyt + noise))


def fake_record(folder: Path, *, world: str = "room") -> Path:
    folder.mkdir(parents=True)
    stamps, truth, _ = write_bag(folder / "bag", particles=False, world=world)
    write_truth(folder, stamps, truth, world)
    (folder / "config.yaml").write_text(f"world: {world}\nrobot: burger\n")
    command = ["turtlebag", "record", "--world", world, "--robot", "burger", "--out", str(folder)]
    write_manifest(folder, stage="record", command=command, inputs={}, seed=1, wall_s=1.0)
    return folder


def fake_map(folder: Path, record: Path, *, sigma_m: float = 0.005) -> Path:
    folder.mkdir(parents=True)
    stamps = np.arange(TICKS, dtype=np.int64)[::6] * TICK_NS
    save_tum(noisy(Trajectory(stamps, ellipse()[::6]), sigma_m), folder / "trajectory.tum")
    save_map(mapped_room(), folder)
    (folder / "config.yaml").write_text(f"voxel: 0.2\nfront: {{sigma: {sigma_m}}}\n")
    truth = load_tum(record / "truth/trajectory.tum")
    estimate = load_tum(folder / "trajectory.tum")
    metrics = {
        "scans": 150,
        "keyframes": 3,
        "loops": {"proposed": 9, "accepted": 5, "rejected": 4},
        "log_s": estimate.duration(),
        **trajectory_metrics(estimate, truth),
        "map": map_metrics(mapped_room(), true_room()),
        "curious": {"value": 0.25},
    }
    (folder / "graph.g2o").write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 0.1 0 0\n"
        "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 0 2 0 0 0.02 100 0 0 100 0 400\n"
    )
    verdicts = ["accepted"] * 5 + ["low overlap"] * 4
    loops = [{"i": 2, "j": 0, "residual_m": 0.1, "verdict": verdict} for verdict in verdicts]
    write_json(folder / "graph.json", {"loops": loops})
    write_json(folder / "metrics.json", metrics)
    command = ["turtlebag", "map", str(record), "--out", str(folder)]
    inputs = {"source": record / "bag"}
    write_manifest(folder, stage="map", command=command, inputs=inputs, seed=None, wall_s=1.0)
    return folder


def fake_maps(base: Path) -> Path:
    """A record, and two maps of it that differ: `record`, `a` and `b` in a folder."""
    record = fake_record(base / "record")
    fake_map(base / "a", record)
    fake_map(base / "b", record, sigma_m=0.02)
    return record


def fake_run(
    folder: Path,
    map_folder: Path,
    *,
    task: str = "patrol",
    missed: bool = False,
    where: tuple = GOALS,
    seed: int = 1,
) -> Path:
    """`missed`: the second goal ends in a timeout, after contact. `where`: other goals, so that the robot is
    not at those it takes to be reached."""
    folder.mkdir(parents=True)
    stamps, truth, odometry = write_bag(folder / "bag", particles=True, goals=where)
    write_truth(folder, stamps, truth)
    estimate = noisy(Trajectory(stamps[::6], truth[::6]), 0.01)
    save_tum(estimate, folder / "trajectory.tum")
    rows = [
        Row(
            int(stamps[k]),
            T_world_base=truth[k],
            T_map_base=truth[k],
            T_odom_base=odometry[k],
            command=Twist(0.2, 0.1),
            clearance_m=0.3 + 0.2 * float(np.sin(k / 90.0)),
            contact_visible=missed and 400 <= k < 410,
            contact_low=False,
            goal_index=k // 300,
            state="reached" if k % 300 == 299 and not (missed and k // 300 == 1) else "drive",
        )
        for k in range(TICKS)
    ]
    RunLog.of(rows).save(folder / "runlog.csv")
    (folder / "config.yaml").write_text("world: room\nrobot: burger\n")
    goals = []
    for number, (x, y) in enumerate(where):
        late = missed and number == 1
        last = 300 * number + (300 if late else 299)
        error_m, error_rad = pose_error(truth[last], SE2.from_xyt(x, y, 0.0))
        goals.append(
            {
                "x": x,
                "y": y,
                "yaw": 0.0,
                "status": "timeout" if late else "reached",
                "time_s": (last - 300 * number) * TICK_NS * 1e-9,
                "error_m": error_m,
                "error_rad": error_rad,
            }
        )
    scans = Trajectory(stamps[::6], truth[::6])
    metrics = {
        "task": task,
        "success": not missed,
        "true_success": not missed and max(goal["error_m"] for goal in goals) <= 0.25,
        "goals": goals,
        "collisions": {"visible": int(missed), "low": 0},
        "min_clearance_m": min(0.3 + 0.2 * float(np.sin(k / 90.0)) for k in range(TICKS)),
        "distance_m": Trajectory(stamps, truth).length(),
        "time_s": float(stamps[-1]) * 1e-9,
        "localisation_error_m": ate(estimate, scans, align=False),
    }
    write_json(folder / "metrics.json", metrics)
    command = ["turtlebag", "navigate", "--world", "room", "--map", f"{map_folder}/map.yaml", "--task", task]
    command += ["--seed", str(seed), "--out", str(folder)]
    inputs = map_files(map_folder / "map.yaml")
    write_manifest(folder, stage="navigate", command=command, inputs=inputs, seed=seed, wall_s=1.0)
    return folder


def fake_localise(folder: Path, record: Path, map_folder: Path) -> Path:
    folder.mkdir(parents=True)
    truth = load_tum(record / "truth/trajectory.tum")
    save_tum(noisy(truth, 0.01), folder / "trajectory.tum")
    error = ate(load_tum(folder / "trajectory.tum"), truth, align=False)
    metrics = {"scans": 150, "success": True, "status": "localised", "localisation_error_m": error}
    write_json(folder / "metrics.json", metrics)
    command = ["turtlebag", "localise", str(record), "--map", f"{map_folder}/map.yaml", "--out", str(folder)]
    inputs = {"bag": record, **map_files(map_folder / "map.yaml")}
    write_manifest(folder, stage="localise", command=command, inputs=inputs, seed=1, wall_s=1.0)
    return folder


def fake_plan(folder: Path, map_folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "path.csv").write_text("x,y,yaw\n-2,-1.5,0\n0,-1.5,0\n2,-1.5,0\n")
    write_json(folder / "metrics.json", {"success": True, "length_m": 4.0})
    command = ["turtlebag", "plan", "--map", f"{map_folder}/map.yaml", "--out", str(folder)]
    inputs = map_files(map_folder / "map.yaml")
    write_manifest(folder, stage="plan", command=command, inputs=inputs, seed=1, wall_s=1.0)
    return folder


def _unsaved(figure: matplotlib.figure.Figure, where: object, **options: object) -> None:
    """In the place of saving a figure: an empty drawing."""
    if isinstance(where, Path):
        where.touch()
    else:
        where.write("<svg></svg>")


@contextmanager
def unrendered():
    """Reports made inside compose every figure, but have none laid out and saved, which takes nine tenths of
    a report's time: their pictures are empty."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.figure.Figure, "savefig", _unsaved)
        patch.setattr(matplotlib.figure.Figure, "get_layout_engine", lambda figure: None)
        yield


undrawn = unrendered
"""The name by which tests of words and tables ask for it."""


def rehash(folder, name):
    """Make a manifest vouch for a changed file."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["outputs"][name] = sha256_file(folder / name)
    path.write_text(json.dumps(manifest))
