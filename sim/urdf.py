"""A robot specification as URDF: one rigid body with its masses, and wheels on revolute joints."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.sim.robots import BoxPart, Part, RobotSpec

TREAD = 0.2
"""A wheel stands on a narrow tread (this share of its width), as a crowned tyre does: a rigid cylinder of
full width would be carried now by one edge, now by the other, and the track would jump by its width."""


def composite(parts: list[Part]) -> tuple[float, Array, Array]:
    """Mass [kg], centre of mass (3,) and principal-axis inertia (3,) [kg m^2] of rigidly joined parts.

    Parallel-axis theorem; the small products of inertia are left out.
    """
    masses = np.array([part.mass for part in parts])
    centers = np.array([part.com for part in parts])
    mass = float(masses.sum())
    com = masses @ centers / mass
    offset = centers - com
    steiner = masses[:, None] * (np.sum(offset**2, axis=1, keepdims=True) - offset**2)
    return mass, com, (np.array([part.inertia for part in parts]) + steiner).sum(axis=0)


def _xyz(vector: tuple[float, ...] | Array) -> str:
    return " ".join(repr(float(value)) for value in vector)


def _geometry(part: Part) -> str:
    if isinstance(part, BoxPart):
        return f'<box size="{_xyz(part.size)}"/>'
    return f'<sphere radius="{part.radius!r}"/>'


def _inertial(mass: float, com: tuple[float, ...] | Array, inertia: tuple[float, ...] | Array) -> str:
    ixx, iyy, izz = (repr(float(value)) for value in inertia)
    return (
        f'<inertial><origin xyz="{_xyz(com)}"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def urdf(robot: RobotSpec) -> str:
    """URDF with `base_footprint` as root: on the floor, midway between the wheels, x forward."""
    wheels = robot.wheels
    collisions = "".join(
        f'<collision><origin xyz="{_xyz(part.center)}"/><geometry>{_geometry(part)}</geometry></collision>'
        for part in robot.parts
    )
    # What walls touch of the axle: a box as wide as the wheels, clear of the floor; it has no mass.
    guard = (1.6 * wheels.radius, 2.0 * wheels.joint_y + wheels.width, 1.2 * wheels.radius)
    collisions += (
        f'<collision><origin xyz="{_xyz((0.0, 0.0, wheels.radius))}"/>'
        f'<geometry><box size="{_xyz(guard)}"/></geometry></collision>'
    )
    text = [f'<robot name="{robot.name}"><link name="base_footprint">']
    text += [_inertial(*composite(robot.parts)), collisions, "</link>"]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        text.append(
            f'<link name="wheel_{side}">{_inertial(wheels.mass, (0.0, 0.0, 0.0), wheels.inertia)}'
            f'<collision><origin xyz="0 0 0" rpy="{np.pi / 2.0!r} 0 0"/><geometry>'
            f'<cylinder radius="{wheels.radius!r}" length="{TREAD * wheels.width!r}"/>'
            f"</geometry></collision>"
            f'</link><joint name="wheel_{side}_joint" type="continuous"><parent link="base_footprint"/>'
            f'<child link="wheel_{side}"/><origin xyz="{_xyz((0.0, sign * wheels.joint_y, wheels.radius))}"/>'
            f'<axis xyz="0 1 0"/></joint>'
        )
    return "".join([*text, "</robot>"])
