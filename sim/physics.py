"""The Bullet simulation: floor, solids, and the robot as an articulated body driven by its wheels."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.sim import bullet
from turtlebag.sim.bullet_bodies import create_bodies, create_body, groups
from turtlebag.sim.robots import PERIOD_S, RobotSpec
from turtlebag.sim.shapes import Solid
from turtlebag.sim.urdf import composite, urdf

JOINTS = [0, 1]
"""Numbers of the wheels' joints, left and right."""
CONTACT_GAP_M = 5e-4
"""Bullet keeps points of bodies that are merely near; nearer than this they touch."""


SUBSTEPS, SOLVER_ITERATIONS = 8, 20
"""Physics steps a control step (240 Hz), and how often Bullet goes over the contacts in each.

Fewer iterations leave the wheels' speeds off by half a percent, and with four steps walls give way by 2 mm.
"""
BODY_FRICTION = 0.1
"""Caster on the floor, body on walls, which both have 1."""


class PhysicsConfig(Settings):
    """What can be set of the physics."""

    friction: Annotated[float, Field(gt=0.0)] | None = None
    """Coefficient of the wheels on the floor, which has 1; None: as in the robot's file."""


class Physics:
    """One Bullet client with one robot in it. Poses are of base_footprint in the world frame."""

    def __init__(
        self,
        standing: Sequence[Solid],
        moving: Sequence[Solid],
        robot: RobotSpec,
        config: PhysicsConfig,
    ) -> None:
        self._solids, self._n_standing = [*standing, *moving], len(standing)
        self._n_own = len(self._solids)
        self._robot, self._friction = robot, config.friction
        self.client = bullet.connect(bullet.DIRECT)
        self._com = tuple(float(value) for value in composite(robot.parts)[1])
        self._forces = [robot.wheels.torque] * 2

    def close(self) -> None:
        """Disconnect from Bullet; closing twice is harmless."""
        if self.client >= 0:
            bullet.disconnect(self.client)
            self.client = -1

    def reset(self, T_world_base: SE2, moving_xy: Sequence[Array] = ()) -> None:
        """Build everything anew with the robot at a pose, and let it settle on its wheels.

        `moving_xy` says where the moving solids stand meanwhile, (2,) each. What was dropped is gone.
        """
        client = self.client
        del self._solids[self._n_own :]
        bullet.resetSimulation(physicsClientId=client)
        bullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=PERIOD_S / SUBSTEPS,
            numSubSteps=0,
            numSolverIterations=SOLVER_ITERATIONS,
            # A cone takes longer, and slips up to twice as much as it would after 200 iterations.
            enableConeFriction=0,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        floor = bullet.createMultiBody(
            0.0,
            bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client),
            # A plain rigid body: as a multi-body it would take a tenth of each physics step.
            useMaximalCoordinates=1,
            physicsClientId=client,
        )
        bullet.changeDynamics(floor, -1, lateralFriction=1.0, physicsClientId=client)
        reachable = [s.z_min < self._robot.height and s.z_max > 0.0 for s in self._solids]
        movers = range(self._n_standing, len(self._solids))
        self._body_of = {number: create_body(self._solids[number], client) for number in movers}
        self._solid_of = {body: number for number, body in self._body_of.items()}
        for group in groups(self._solids[: self._n_standing], reachable, self._robot.lidar_height):
            bodies = create_bodies([self._solids[n] for n in group], client)
            self._solid_of |= dict.fromkeys(bodies, group[0])
        for number, xy in enumerate(moving_xy):
            self.place(number, xy, np.zeros(2))
        self._load_robot(T_world_base)
        for _ in range(round(0.5 / PERIOD_S)):
            self.step(0.0, 0.0)

    def _load_robot(self, T_world_base: SE2) -> None:
        client = self.client
        x, y, yaw = (float(value) for value in T_world_base.xyt)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            path.write_text(urdf(self._robot))
            self.body = bullet.loadURDF(
                str(path),
                [x, y, 0.0],
                bullet.getQuaternionFromEuler([0.0, 0.0, yaw]),
                flags=bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_USE_IMPLICIT_CYLINDER,
                physicsClientId=client,
            )
        wheel_friction = self._friction or self._robot.wheels.friction
        for link, friction in [(-1, BODY_FRICTION)] + [(j, wheel_friction) for j in JOINTS]:
            bullet.changeDynamics(
                self.body,
                link,
                lateralFriction=friction,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )

    def step(self, left: float, right: float, *, watch: bool = False) -> set[int]:
        """One control step with the wheel motors aiming at these speeds [rad/s].

        With `watch`, the solids that the robot touched in any of its physics steps (see `touched`).
        """
        bullet.setJointMotorControlArray(
            self.body,
            JOINTS,
            bullet.VELOCITY_CONTROL,
            targetVelocities=[left, right],
            forces=self._forces,
            physicsClientId=self.client,
        )
        found: set[int] = set()
        step = bullet.stepSimulation
        for _ in range(SUBSTEPS):
            step(self.client)
            if watch:
                found |= self.touched()
        return found

    def place(self, number: int, xy: Array, velocity: Array) -> None:
        """Put moving solid `number` somewhere; its velocity is what it pushes with. Never the robot."""
        body = self._body_of[self._n_standing + number]
        solid = self._solids[self._n_standing + number]
        bullet.resetBasePositionAndOrientation(
            body,
            [float(xy[0]), float(xy[1]), 0.5 * (solid.z_min + solid.z_max)],
            [0.0, 0.0, 0.0, 1.0],
            physicsClientId=self.client,
        )
        speed = [float(velocity[0]), float(velocity[1]), 0.0]
        bullet.resetBaseVelocity(body, speed, [0.0, 0.0, 0.0], physicsClientId=self.client)

    def drop(self, solid: Solid) -> None:
        """Add a static solid; its number follows those of all others."""
        self._solid_of[create_body(solid, self.client)] = len(self._solids)
        self._solids.append(solid)

    def put_down(self, T_world_base: SE2) -> None:
        """Set the robot down elsewhere, at rest; its wheels keep their angles."""
        x, y, yaw = (float(value) for value in T_world_base.xyt)
        cx, cy, _ = self._com
        height = bullet.getBasePositionAndOrientation(self.body, physicsClientId=self.client)[0][2]
        com = [
            x + math.cos(yaw) * cx - math.sin(yaw) * cy,
            y + math.sin(yaw) * cx + math.cos(yaw) * cy,
            height,
        ]
        turn = bullet.getQuaternionFromEuler([0.0, 0.0, yaw])
        bullet.resetBasePositionAndOrientation(self.body, com, turn, physicsClientId=self.client)
        bullet.resetBaseVelocity(self.body, [0.0] * 3, [0.0] * 3, physicsClientId=self.client)

    def pose(self) -> tuple[float, float, float]:
        """x, y, yaw of base_footprint."""
        (px, py, _), (qx, qy, qz, qw) = bullet.getBasePositionAndOrientation(
            self.body, physicsClientId=self.client
        )
        cx, cy, cz = self._com
        # First two rows of the rotation matrix, applied to the centre of mass in the base frame.
        x = px - (
            (1.0 - 2.0 * (qy * qy + qz * qz)) * cx
            + 2.0 * (qx * qy - qz * qw) * cy
            + 2.0 * (qx * qz + qy * qw) * cz
        )
        y = py - (
            2.0 * (qx * qy + qz * qw) * cx
            + (1.0 - 2.0 * (qx * qx + qz * qz)) * cy
            + 2.0 * (qy * qz - qx * qw) * cz
        )
        return x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))

    def velocity(self, yaw: float) -> tuple[float, float]:
        """Forward speed of base_footprint [m/s] and yaw rate [rad/s], for a base at that yaw."""
        (vx, vy, _), (_, _, w) = bullet.getBaseVelocity(self.body, physicsClientId=self.client)
        # The centre of mass lies off the turning axis: take away w x offset (its part along x).
        return vx * math.cos(yaw) + vy * math.sin(yaw) + w * self._com[1], w

    def wheels(self) -> tuple[float, float, float, float]:
        """Angles (left, right) [rad] and speeds (left, right) [rad/s] of the wheels."""
        left, right = bullet.getJointStates(self.body, JOINTS, physicsClientId=self.client)
        return left[0], right[0], left[1], right[1]

    def touched(self) -> set[int]:
        """Indices of solids that the robot touches now, the standing ones first.

        Of standing solids that share a body (all seen by the lidar, or none) the first stands for all.
        """
        found = set()
        for point in bullet.getContactPoints(bodyA=self.body, physicsClientId=self.client):
            number = self._solid_of.get(point[2])
            if number is not None and (point[9] > 0.0 or point[8] < CONTACT_GAP_M):
                found.add(number)
        return found
