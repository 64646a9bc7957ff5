"""The simulator of a robot in a world: commands in, observations out. Observations hold no ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Cloud, Joints, Observation, Odometry, Scan, Twist
from turtlebag.sim.faults import FaultConfig, Faults
from turtlebag.sim.imu import ImuConfig, ImuSensor
from turtlebag.sim.lidar import GAZEBO_SIGMA, Lidar, LidarConfig
from turtlebag.sim.lidar3d import Lidar3d
from turtlebag.sim.lidar_sweeps import Sweep
from turtlebag.sim.physics import Physics, PhysicsConfig
from turtlebag.sim.robots import CONTROL_HZ as CONTROL_HZ
from turtlebag.sim.robots import LidarErrors, RobotSpec, stamp_of
from turtlebag.sim.shapes import Solid
from turtlebag.sim.surroundings import Surroundings
from turtlebag.sim.wheels import Board, OdometryConfig
from turtlebag.sim.world import World

Sensors = Literal["realistic", "clean"]
REALISTIC_SLIP = {"slip": 0.001, "turn_slip": 0.005}
"""Sigma after a metre [m] and after a radian [rad]: assumed, for a hard floor and rubber tyres."""
CONTACT_REACH_M = 0.05
"""Contacts are checked if the robot's centre is closer to a solid than its own radius plus this."""


class SimConfig(Settings):
    """The settings of the simulator.

    `sensors` is the preset of lidar and wheels for everything not set otherwise: `realistic` like the
    hardware, `clean` like Gazebo, with white lidar noise and no random slip.
    """

    sensors: Sensors = "realistic"
    """`realistic`: errors as of the hardware; `clean`: as in Gazebo, white lidar noise and no random slip."""
    physics: PhysicsConfig = PhysicsConfig()
    lidar: LidarConfig = LidarConfig()
    odometry: OdometryConfig = OdometryConfig()
    imu: ImuConfig = ImuConfig()
    faults: FaultConfig = FaultConfig()

    def resolved(self, robot: RobotSpec) -> SimConfig:
        """The same with all numbers that come from the preset `sensors` and the robot's lidar filled in."""
        realistic, lidar, odometry = self.sensors == "realistic", self.lidar, self.odometry
        noise = lidar.noise or ("sensor" if realistic or lidar.errors is not None else "gazebo")
        errors = None
        if noise == "sensor":
            given = {} if lidar.sigma is None else {"sigma": lidar.sigma}
            given |= {} if lidar.errors is None else lidar.errors.model_dump(exclude_unset=True)
            errors = LidarErrors.model_validate(robot.lidar.errors.model_dump() | given)
        share = robot.wheels.calibration_error
        usual = {"radius_error": share, "track_error": share}
        for name, assumed in REALISTIC_SLIP.items():
            own = getattr(robot.wheels, name)
            usual[name] = 0.0 if not realistic else assumed if own is None else own
        wheel_errors = {name: of for name, of in usual.items() if getattr(odometry, name) is None}
        return self.model_copy(
            update={
                "lidar": lidar.model_copy(update={"noise": noise, "errors": errors}),
                "odometry": odometry.model_copy(update=wheel_errors),
                "imu": self.imu.resolved(robot.imu),
            }
        )


@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth: true pose and twist, and contacts with anything but the floor.

    A contact is `visible` if the touched solid crosses the lidar plane, else `low`; contacts in any
    physics step since the last control step count.
    """

    stamp_ns: int
    T_world_base: SE2
    twist: Twist
    contact_visible: bool
    contact_low: bool


class _Sensors:
    """What the robot carries: an IMU, lidars that turn and, on some, a 3D lidar."""

    def __init__(self, world: World, robot: RobotSpec, config: SimConfig, seed: int, step: int) -> None:
        """The first turns begin at control step `step`."""
        self.imu = ImuSensor(robot, config.imu, stream(seed, "imu"))
        lidar, mount, turning = config.lidar, robot.lidar3d, config.lidar.turning
        self.planar = []
        for number, (name, one) in enumerate(robot.lidars.items()):
            carrier, errors = robot.model_copy(update={"lidar": one}), lidar.errors_of(robot.lidar, one)
            own = lidar.model_copy(update={"errors": errors})
            head = Lidar(world.shapes, carrier, own, stream(seed, f"lidar{name}"))
            steps = round(CONTROL_HZ / (lidar.rate_hz or one.rate_hz))
            # nothing makes lidars turn together
            later = number * steps // len(robot.lidars)
            self.planar.append(Sweep(head, steps, step, turning=turning, later=later))
        self.spatial: Sweep[Lidar3d] | None = None
        if mount is not None:
            sigma = 0.0 if lidar.noise == "none" else GAZEBO_SIGMA if lidar.sigma is None else lidar.sigma
            moving = [mover.solid for mover in world.movers]
            head3d = Lidar3d(world.shapes, mount, sigma, stream(seed, "lidar3d"), moving)
            self.spatial = Sweep(head3d, round(CONTROL_HZ / mount.rate_hz), step, turning=turning)
        self._sweeps: list[Sweep[Any]] = [*self.planar, *([] if self.spatial is None else [self.spatial])]

    def surround(self, solids: list[Solid]) -> None:
        """These solids stand there from now on."""
        for sweep in self._sweeps:
            sweep.lidar.surround(solids)

    def note_movers(self, around: Surroundings, step: int) -> None:
        """Where the movers stand at a control step."""
        for sweep in self.planar:
            sweep.lidar.note_movers(around.visible_movers, sweep.steps_before(step))
        if self.spatial is not None:
            positions = [one.position.copy() for one in around.movers]
            self.spatial.lidar.note_movers(positions, self.spatial.steps_before(step))

    def put_down(self, T_world_base: SE2) -> None:
        """The robot was carried here: of the sweeps under way there is no scan."""
        for sweep in self._sweeps:
            sweep.put_down(T_world_base.xyt)

    def scans(self, step: int, pose: Array) -> Iterator[tuple[Scan, SE2]]:
        """The scans whose turns end in this step, and the true poses at their stamps."""
        for number, sweep in enumerate(self.planar):
            done = sweep.add(step, pose)
            if done is not None:
                scan = Scan(done.stamp_ns, done.measured, sweep.lidar.spec, number)
                yield scan, SE2(done.pose_at_stamp)

    def cloud(self, step: int, pose: Array) -> tuple[int, Cloud] | None:
        """Stamp and cloud of the 3D lidar, if there is one, when its sweep ends."""
        done = None if self.spatial is None else self.spatial.add(step, pose)
        return None if done is None else (done.stamp_ns, done.measured)


class Simulator:
    """Simulates in steps of 1/30 s, each of eight physics steps. A context manager, as it owns a
    Bullet client.

    Call `reset` first, then `step`. The same world, robot, config, seed and commands give
    the same observations to the last bit.
    """

    truth: Truth
    """True state after the last step."""
    scan_truth: SE2
    """True base pose at the stamp of the scan that was delivered last."""
    surroundings: Surroundings
    """Solids and movers around the robot."""

    def __init__(
        self, world: World, robot: RobotSpec, config: SimConfig | None = None, seed: int = 0
    ) -> None:
        self.world, self.robot, self.seed = world, robot, seed
        self.config = (config or SimConfig()).resolved(robot)
        moving = [mover.solid for mover in world.movers]
        self._physics = Physics(world.shapes, moving, robot, self.config.physics)
        self._step = -1

    def __enter__(self) -> Simulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the physics client."""
        self._physics.close()

    def reset(self, T_world_base: SE2 | None = None, step: int = 0) -> Observation:
        """Place the robot (default: the world's spawn) at control step `step`; odometry starts there.

        Dropped solids are removed. InputError if the pose overlaps a solid.
        """
        start = self.world.spawn if T_world_base is None else T_world_base
        around = Surroundings(self.world, self.robot, self.seed)
        around.require_free(start, "start pose")
        for kidnap in self.config.faults.kidnap:
            around.require_free(SE2.from_xyt(*kidnap[1:]), "faults.kidnap")
        self.surroundings = around
        self._sensors = _Sensors(self.world, self.robot, self.config, self.seed, step)
        late = self.config.faults.command_delay + self.robot.limits.command_delay
        faults = self.config.faults.model_copy(update={"command_delay": late})
        self._faults = Faults(faults, stream(self.seed, "faults"), step)
        self._board = Board(self.robot, self.config.odometry, self.seed, start)
        self._physics.reset(start, [one.position for one in around.movers])
        self._step = step
        self._place_movers()
        self.scan_truth = start
        return self._observe(self._physics.touched())

    def step(self, command: Twist) -> Observation:
        """Drive for one control period."""
        if self._step < 0:
            raise RuntimeError("reset the simulator before the first step")
        self.surroundings.step(self.truth.T_world_base.xy)
        self._place_movers()
        wheels = self._board.motors.step(self._faults.command(command))
        wheels = self._faults.grip(self._step + 1, *wheels)
        reach = self.robot.model.circumscribed_radius + CONTACT_REACH_M
        reach += 2.0 * self.robot.limits.max_v / CONTROL_HZ
        near = self.surroundings.within(reach, self.truth.T_world_base)
        touched = self._physics.step(*wheels, watch=near)
        self._step += 1
        place = self._faults.kidnapped(self._step)
        if place is not None:
            self._put_down(place)
        return self._observe(touched)

    def carry(self, T_world_base: SE2) -> None:
        """Kidnap the robot, between two steps; InputError if it cannot stand there."""
        self.surroundings.require_free(T_world_base, "pose")
        self._put_down(T_world_base)
        self.truth = replace(self.truth, T_world_base=T_world_base)

    def drop(self, solid: Solid) -> None:
        """Add a solid to the floor; InputError if it would touch the robot."""
        self.surroundings.drop(solid, self.truth.T_world_base)
        self._physics.drop(solid)
        self._sensors.surround(self.surroundings.solids)

    def clearance(self) -> float:
        """Distance from the footprint polygon to the nearest surface up to the robot's height [m]."""
        return self.surroundings.clearance(self.truth.T_world_base)

    def _place_movers(self) -> None:
        """Tell physics and lidars where the movers stand now."""
        if self.surroundings.movers:
            for number, one in enumerate(self.surroundings.movers):
                self._physics.place(number, one.position, one.velocity)
            self._sensors.note_movers(self.surroundings, self._step)

    def _put_down(self, T_world_base: SE2) -> None:
        """Carry the robot elsewhere."""
        self._physics.put_down(T_world_base)
        self._sensors.put_down(T_world_base)

    def _observe(self, touched: Iterable[int]) -> Observation:
        stamp = stamp_of(self._step)
        x, y, yaw = self._physics.pose()
        left, right, left_speed, right_speed = self._faults.encoders(self._step, *self._physics.wheels())
        left, right = self._board.slip.encoders(left, right)
        pose = np.array([x, y, yaw])
        twist = Twist(*self._physics.velocity(yaw))
        self.truth = Truth(stamp, SE2(pose), twist, *self.surroundings.contacts(touched))
        return Observation(
            stamp,
            Odometry(stamp, *self._board.odometry.update(left, right)),
            Joints(stamp, (left, right), (left_speed, right_speed)),
            self._sweep_on(pose),
            self._faults.imu(self._sensors.imu.samples(self._step, twist)),
            self._sensors.cloud(self._step, pose),
        )

    def _sweep_on(self, pose: Array) -> Scan | None:
        """The scan that is delivered in this step, usually the one whose turn ended in it."""
        delivered = self._faults.scan(self._step, self._sensors.scans(self._step, pose))
        if delivered is None:
            return None
        scan, self.scan_truth = delivered
        return scan
