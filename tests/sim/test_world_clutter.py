"""Unmapped clutter: where it may be, what it leaves free, that it repeats."""

import numpy as np

from turtlebag.sim.raycast import distance_to_point
from turtlebag.sim.shapes import sections
from turtlebag.sim.worlds import load_world

ARENA = load_world("turtlebot3_world")


def boxes_of(world):
    return [shape for shape in world.shapes if shape.name.startswith("clutter_")]


def test_boxes_and_movers_keep_off_the_spawn_and_the_routes():
    for seed in range(5):
        world = load_world(f"turtlebot3_world+clutter:{seed},boxes=6,movers=4")
        boxes = boxes_of(world)
        assert (len(boxes), len(world.movers)) == (6, 4)
        lines = sections(boxes, 0.0, 1.0)
        for x, y in np.vstack([ARENA.routes["tour"], ARENA.routes["patrol"]]):
            assert distance_to_point(x, y, lines.segments, lines.circles) > 0.3
        spawn = distance_to_point(*ARENA.spawn.xy, lines.segments, lines.circles)
        assert spawn > 0.7
        for mover in world.movers:
            assert np.linalg.norm(mover.path[0] - ARENA.spawn.xy) > 0.8
            assert mover.yields


def test_most_of_the_floor_stays_within_reach():
    worlds = load_world("turtlebot3_world+clutter:2,boxes=9"), load_world("turtlebot3_world")
    free = [(world.rasterize(0.2).cells == 0).sum() for world in worlds]
    assert 0.8 * free[1] < free[0] < free[1]


def test_more_boxes_keep_the_first_and_leave_the_movers_alone():
    few, many = (load_world(f"turtlebot3_world+clutter:7,boxes={n},movers=3") for n in (2, 5))
    for a, b in zip(boxes_of(few), boxes_of(many), strict=False):
        np.testing.assert_array_equal(a.polygon, b.polygon)
    for a, b in zip(few.movers, many.movers, strict=True):
        np.testing.assert_array_equal(a.path, b.path)
    other = load_world("turtlebot3_world+clutter:8,boxes=2,movers=3")
    assert not np.array_equal(boxes_of(few)[0].polygon, boxes_of(other)[0].polygon)
    assert boxes_of(load_world("turtlebot3_world+clutter:7,boxes=0")) == []
