"""Stage `record`: a scripted drive through a world, as a bag with the truth beside it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.footprint import footprint_text
from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.bags.source import PACKED, SUFFIXES
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import LONGEST_S, seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, sha256_text
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.trajectories import save_tum
from turtlebag.datasets.true_maps import save_true_map
from turtlebag.datasets.types import Observation, Stamps, Trajectory, Twist
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.navigation.recorder import trajectory_of
from turtlebag.pipeline.stages.requests.drives import KeyboardRequest, RecordRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.terminal.interrupts import deferred_interrupt, require_no_hangup
from turtlebag.pipeline.terminal.messages import Simulated, log, redrawn, simulated_time
from turtlebag.sim.robots import RobotSpec, load_robot, static_transforms
from turtlebag.sim.script_driver import Stuck
from turtlebag.sim.simulator import SimConfig, Simulator, Truth
from turtlebag.sim.teleop_scripts import commands, load_script, script_names
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world, own_files

MANY_SHAPES = 1000


class RecordOptions(Settings):
    """What --config and --set may change."""

    sim: SimConfig = SimConfig()


class RecordConfig(Settings):
    """The resolved settings of a recording."""

    world: str
    robot: str
    teleop: str
    seed: int
    start: tuple[float, float, float] | None = None
    """True start pose: x, y [m], yaw [rad]; None: the world's spawn."""
    sim: SimConfig = SimConfig()


def save_truth(folder: Path, truth: Trajectory, world: World, robot: RobotSpec) -> None:
    """Write `truth/`: the true poses at the scans, and the world's map at the height of the lidar plane."""
    folder.mkdir()
    save_tum(truth, folder / "trajectory.tum")
    z = robot.lidar_height
    save_true_map(world.rasterize(z), world.circles(z), folder)


def record_script(request: RecordRequest, out: Output) -> int:
    """Record what a request for a recording asks for; the exit code of `record`."""
    return record(scene_of(request), request.teleop, out)


def record_keyboard(request: KeyboardRequest, out: Output) -> int:
    """Record a drive with the keyboard; the exit code of `record`."""
    from turtlebag.pipeline.terminal import keyboard_teleop

    scene = scene_of(request)
    state = keyboard_teleop.KeyState(scene.robot.limits, request.style)
    keyboard_teleop.show(keyboard_teleop.TABLES[request.style] + "\n")
    with keyboard_teleop.keys_of(sys.stdin.fileno()) as read_keys, redrawn() as redraw:
        driver = keyboard_teleop.keyboard_driver(state, read_keys, keyboard_teleop.clock(request.speed))
        shown = keyboard_teleop.StatusLine(state, redraw)
        return record_drive(scene, driver, f"keyboard:{request.style}", out, watch=shown)


def record(scene: Scene, teleop: str, out: Output) -> int:
    """Record a drive by a script, or by the /cmd_vel of a bag; returns the exit code.

    0 done, 1 the robot got stuck, 130 interrupted, 143 terminated; what was recorded until then is
    complete and kept. Unfinished when the disk is full or the terminal was closed: then it is kept beside
    the output.
    """
    inputs = _own_teleop(teleop)
    if inputs and is_recording(teleop):
        driver, label = replayed(Path(teleop))
    else:
        if (count := len(scene.world.shapes)) > MANY_SHAPES:
            log.info(f"{count} shapes: planning the drive may take minutes")
        driver, label = commands(load_script(teleop), scene.world, scene.robot, scene.seed), teleop
    return record_drive(scene, driver, label, out, inputs=inputs)


def record_again(request: RecordRequest | KeyboardRequest, bag: Path, out: Output) -> int:
    """A drive that a person drove, or ended, once more by the commands in its own bag."""
    driver, _ = replayed(bag)
    if isinstance(request, KeyboardRequest):
        return record_drive(scene_of(request), driver, f"keyboard:{request.style}", out)
    inputs, label = _own_teleop(request.teleop), request.teleop
    if inputs and is_recording(label):
        _, label = replayed(Path(label))
    return record_drive(scene_of(request), driver, label, out, inputs=inputs)


def _own_teleop(teleop: str) -> dict[str, Path]:
    own = teleop not in script_names() and Path(teleop).exists()
    return {"teleop": Path(teleop)} if own else {}


@dataclass(frozen=True, eq=False)
class Scene:
    """What is simulated: a robot in a world, where it starts, the settings and the seed."""

    world_name: str
    robot_name: str
    world: World
    robot: RobotSpec
    sim: SimConfig
    start: SE2 | None
    seed: int

    @staticmethod
    def load(
        world: str,
        robot: str | None = None,
        seed: int = 1,
        sim: SimConfig | None = None,
        start: SE2 | None = None,
    ) -> Scene:
        """Look the names up; InputError for unknown ones."""
        loaded = load_world(world)
        name = robot or loaded.robot
        spec = load_robot(name)
        return Scene(world, name, loaded, spec, (sim or SimConfig()).resolved(spec), start, seed)

    def config(self, teleop: str) -> RecordConfig:
        """The resolved settings, to be saved."""
        start = None if self.start is None else tuple(self.start.xyt.tolist())
        return RecordConfig(
            world=self.world_name,
            robot=self.robot_name,
            teleop=teleop,
            seed=self.seed,
            start=start,
            sim=self.sim,
        )


def scene_of(request: RecordRequest | KeyboardRequest) -> Scene:
    """What a request for a recording is about; InputError for unknown names."""
    options = load_config(RecordOptions, request.config, request.settings)
    start = None if request.start is None else SE2.from_xyt(*request.start)
    return Scene.load(request.world, request.robot, request.seed, options.sim, start)


def record_drive(
    scene: Scene,
    driver: Generator[Twist, Truth, None],
    teleop: str,
    out: Output,
    *,
    inputs: Mapping[str, Path] | None = None,
    watch: Callable[[Observation], None] | None = None,
    longest_s: float = LONGEST_S,
    tell: bool = True,
) -> int:
    """Record what a driver does (sim.teleop_scripts: a generator of commands that is sent the truth).

    `teleop` names it in config.yaml; `watch` is shown every observation. A drive of `longest_s` of simulated
    time is ended as one that got stuck. `tell`: say where it is afterwards. Exit code as of `record`.
    """
    config = scene.config(teleop)
    # Interrupts are held back until all is written: a second Ctrl-C must not lose the recording.
    with deferred_interrupt() as interrupted, out.staged(save_bag=True) as folder:
        (folder / "config.yaml").write_text(config_text(config))
        # Without the driver's name: a bag that is driven again from its own commands is the same bag.
        custom = {
            "seed": str(scene.seed),
            "config_sha256": sha256_text(config_text(scene.config(""))),
            **footprint_text(scene.robot.model.footprint),
        }
        with (
            Simulator(scene.world, scene.robot, scene.sim, scene.seed) as simulator,
            BagWriter(folder / "bag", custom=custom, lidars=scene.robot.lidars) as bag,
            simulated_time() as clock,
        ):
            bounded = _bounded(driver, longest_s)
            truth, duration, stuck = _drive(simulator, scene.start, bounded, bag, watch, clock, interrupted)
        require_no_hangup(interrupted)
        save_truth(folder / "truth", truth, scene.world, scene.robot)
        wall = out.wall_s
        out.finish(
            folder,
            "record",
            {**own_files(scene.world_name, scene.robot_name), **(inputs or {})},
            seed=scene.seed,
            extra={
                "simulated_s": duration,
                "realtime_factor": round(duration / wall, 2),
                **({"interrupted": True} if interrupted else {}),
            },
        )
    if interrupted and tell:
        log.warning("interrupted; the recording so far is kept")
    if tell:
        log.info(
            f"recorded {duration:.1f} s in {wall:.1f} s ({duration / wall:.0f} x real time) -> {out.folder}"
        )
    if stuck:
        log.error("the drive ended early: %s", stuck)
    return 128 + interrupted[0] if interrupted else int(stuck is not None)


def _bounded(driver: Generator[Twist, Truth, None], longest_s: float) -> Generator[Twist, Truth, None]:
    """The driver, which is Stuck once it has driven for so long."""
    command = next(driver)
    while True:
        now = yield command
        if seconds(now.stamp_ns) >= longest_s:
            raise Stuck(f"no more than {longest_s:g} s are simulated")
        try:
            command = driver.send(now)
        except StopIteration:
            return


def _drive(
    simulator: Simulator,
    start: SE2 | None,
    driver: Generator[Twist, Truth, None],
    bag: BagWriter,
    watch: Callable[[Observation], None] | None,
    clock: Simulated,
    interrupted: list[int],
) -> tuple[Trajectory, float, str | None]:
    """Run the driver to its end or to an interrupt: the truth at the scans, how long it took [simulated s],
    and where it got stuck."""
    truth: list[tuple[int, SE2]] = []
    observation = simulator.reset(start)
    bag.static_transforms(observation.stamp_ns, static_transforms(simulator.robot))
    next(driver)
    stuck = None
    while True:
        bag.observation(observation)
        if observation.cloud is not None:
            bag.cloud(observation.stamp_ns, *observation.cloud, "lidar_3d")
        if observation.scan is not None:
            truth.append((observation.scan.stamp_ns, simulator.scan_truth))
        if watch is not None:
            watch(observation)
        clock(observation.stamp_ns, "")
        now = simulator.truth
        bag.truth(now.stamp_ns, now.T_world_base, now.twist)
        if interrupted:
            break
        try:
            command = driver.send(now)
        except StopIteration:
            break
        except Stuck as error:
            stuck = str(error)
            break
        bag.command(observation.stamp_ns, command)
        observation = simulator.step(command)
    bag.command(observation.stamp_ns, Twist())
    return trajectory_of(truth), seconds(observation.stamp_ns), stuck


def is_recording(teleop: str) -> bool:
    """Whether a --teleop argument means a bag or a recording's folder."""
    return Path(teleop).is_dir() or teleop.endswith((*SUFFIXES, *PACKED))


def replayed(path: Path) -> tuple[Generator[Twist, Truth, None], str]:
    """The /cmd_vel of any bag, in order of time, as a driver; and what config.yaml calls it: by its content,
    wherever it lies. InputError when there is none."""
    stamps, v, w = read_commands(path)
    order = np.argsort(stamps, kind="stable")
    stamps, v, w = stamps[order] - stamps[order[0]], v[order], w[order]
    if (span_s := seconds(int(stamps[-1]))) > LONGEST_S:
        raise InputError(f"{path}: its /cmd_vel spans {span_s:g} s; at most {LONGEST_S:g} s are simulated")
    content = (stamps.tolist(), v.tolist(), w.tolist())
    return _driven(stamps, v, w), f"replay:{sha256_text(repr(content))[:16]}"


def _driven(stamps: Stamps, v: Array, w: Array) -> Generator[Twist, Truth, None]:
    """Each command from its stamp on until the next; ends with the last one's."""
    truth = yield Twist()
    while truth.stamp_ns < stamps[-1]:
        now = max(int(np.searchsorted(stamps, truth.stamp_ns, side="right")) - 1, 0)
        truth = yield Twist(float(v[now]), float(w[now]))
