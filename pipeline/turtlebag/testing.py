"""Checks of parts of one's own, to be run in a test: each raises AssertionError in one line.

`turtlebag.testing.check_front_end(MyFrontEnd)` takes the class, or a function that makes one.
"""

from turtlebag.pipeline.conformance.driving import check_controller, check_planner, check_task
from turtlebag.pipeline.conformance.localising import check_localiser
from turtlebag.pipeline.conformance.mapping import check_back_end, check_front_end, check_loop_match
from turtlebag.pipeline.conformance.worlds import check_world

__all__ = [
    "check_back_end",
    "check_controller",
    "check_front_end",
    "check_localiser",
    "check_loop_match",
    "check_planner",
    "check_task",
    "check_world",
]
