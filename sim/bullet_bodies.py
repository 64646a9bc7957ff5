"""Solids as static Bullet bodies, several per body where possible, for speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.sim import bullet
from turtlebag.sim.plans import Plan
from turtlebag.sim.shapes import Ball, Mesh, Solid, as_rectangle

WALLS = 2000
"""Segments of a plan in one body: within the number of corners that Bullet takes everywhere."""
GROUP = 16
"""How many shapes Bullet's Python module takes for one body."""


def groups(solids: Sequence[Solid], reachable: Sequence[bool], lidar_height: float) -> list[list[int]]:
    """Numbers of the reachable solids, those that may share a body together.

    Every body costs its share of each physics step, however far away. Boxes and cylinders that the
    lidar plane cuts share bodies, and so do those it misses; neighbours (by x, then y) first.
    """
    alone: list[list[int]] = []
    shared: dict[bool, list[int]] = {True: [], False: []}
    for number, solid in enumerate(solids):
        if not reachable[number]:
            continue
        if isinstance(solid, (Mesh, Ball)) or not (solid.is_cylinder or as_rectangle(solid.polygon)):
            alone.append([number])
        else:
            shared[solid.crosses(lidar_height)].append(number)
    for numbers in shared.values():
        numbers.sort(key=lambda n: (round(solids[n].center[0]), solids[n].center[1], n))
        alone += [numbers[k : k + GROUP] for k in range(0, len(numbers), GROUP)]
    return alone


def create_bodies(solids: Sequence[Solid], client: int) -> list[int]:
    """The bodies of solids that share one (or of a single solid of any kind); returns their ids."""
    if not isinstance(solids[0], Plan):
        return [create_compound(solids, client)]
    return [
        _create_mesh(walls, client)
        for walls in np.split(solids[0].triangles, range(2 * WALLS, len(solids[0].triangles), 2 * WALLS))
    ]


def create_compound(solids: Sequence[Solid], client: int) -> int:
    """One body for several boxes and cylinders (or for a single solid of any kind); returns its id."""
    if len(solids) == 1:
        return create_body(solids[0], client)
    kinds, halves, radii, lengths, positions, turns = [], [], [], [], [], []
    for solid in solids:
        height, middle = solid.z_max - solid.z_min, 0.5 * (solid.z_max + solid.z_min)
        x, y, length, width, yaw = as_rectangle(solid.polygon) or (*solid.center, 1.0, 1.0, 0.0)
        kinds.append(bullet.GEOM_CYLINDER if solid.is_cylinder else bullet.GEOM_BOX)
        halves.append([length / 2.0, width / 2.0, height / 2.0])
        radii.append(solid.radius or 1.0)
        lengths.append(height)
        positions.append([x, y, middle])
        turns.append(bullet.getQuaternionFromEuler([0.0, 0.0, yaw]))
    shape = bullet.createCollisionShapeArray(
        shapeTypes=kinds,
        halfExtents=halves,
        radii=radii,
        lengths=lengths,
        collisionFramePositions=positions,
        collisionFrameOrientations=turns,
        physicsClientId=client,
    )
    return _static(shape, [0.0, 0.0, 0.0], 0.0, client)


def create_body(solid: Solid, client: int) -> int:
    """A body of its own for a solid; returns its id."""
    height, middle = solid.z_max - solid.z_min, 0.5 * (solid.z_max + solid.z_min)
    position, yaw = [*solid.center, middle], 0.0
    given: dict[str, Any]
    rectangle = as_rectangle(solid.polygon)
    if isinstance(solid, Mesh):
        return _create_mesh(solid.triangles, client)
    if isinstance(solid, Ball):
        given = {"shapeType": bullet.GEOM_SPHERE, "radius": solid.radius}
    elif solid.is_cylinder:
        given = {"shapeType": bullet.GEOM_CYLINDER, "radius": solid.radius, "height": height}
    elif rectangle is not None:
        x, y, length, width, yaw = rectangle
        position = [x, y, middle]
        given = {"shapeType": bullet.GEOM_BOX, "halfExtents": [length / 2.0, width / 2.0, height / 2.0]}
    else:
        outline = solid.polygon - np.array(solid.center)
        corners = [[float(x), float(y), z] for z in (-height / 2.0, height / 2.0) for x, y in outline]
        given = {"shapeType": bullet.GEOM_MESH, "vertices": corners}
    return _static(bullet.createCollisionShape(**given, physicsClientId=client), position, yaw, client)


def _create_mesh(triangles: Array, client: int) -> int:
    """A body of triangles (n, 3, 3) in the world frame."""
    corners, indices = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    shape = bullet.createCollisionShape(
        shapeType=bullet.GEOM_MESH,
        vertices=corners.tolist(),
        indices=indices.ravel().tolist(),
        physicsClientId=client,
    )
    return _static(shape, [0.0, 0.0, 0.0], 0.0, client)


def _static(shape: int, position: list[float], yaw: float, client: int) -> int:
    body = bullet.createMultiBody(
        0.0,
        shape,
        basePosition=position,
        baseOrientation=bullet.getQuaternionFromEuler([0.0, 0.0, yaw]),
        # A plain rigid body: as a multi-body it would take part in every physics step.
        useMaximalCoordinates=1,
        physicsClientId=client,
    )
    bullet.changeDynamics(body, -1, lateralFriction=1.0, physicsClientId=client)
    return int(body)
