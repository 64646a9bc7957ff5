"""Checks of parts of one's own, to be run in a test, and parts that know the truth.

`turtlebag.testing.check_front_end(MyFrontEnd)` takes the class, or a function that makes one; it raises
AssertionError in one line. `TrueFrontEnd`, `TrueLoops` and `TrueLocaliser` take the place of a part to show
what error it causes: `map RECORD --truth RECORD --set front_end=turtlebag.testing:TrueFrontEnd`.
"""

from turtlebag.pipeline.conformance.driving import check_controller, check_planner, check_task
from turtlebag.pipeline.conformance.localising import check_localiser
from turtlebag.pipeline.conformance.mapping import check_back_end, check_front_end, check_loop_match
from turtlebag.pipeline.conformance.truth_parts import TrueFrontEnd, TrueLocaliser, TrueLoops
from turtlebag.pipeline.conformance.worlds import check_world

__all__ = [
    "TrueFrontEnd",
    "TrueLocaliser",
    "TrueLoops",
    "check_back_end",
    "check_controller",
    "check_front_end",
    "check_localiser",
    "check_loop_match",
    "check_planner",
    "check_task",
    "check_world",
]
