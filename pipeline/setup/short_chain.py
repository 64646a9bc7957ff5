"""A short chain in a temporary folder: does everything work here, and are the numeric kernels compiled?"""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

from turtlebag.datasets.outputs import Stopwatch
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.navigation.setup import Request
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.pipeline.stages.record import record
from turtlebag.pipeline.terminal.messages import log

SCRIPT = """\
name: trial
v: 0.2
w: 0.8
steps:
  - {spin: 1}
  - {through: [[-1.5, -1.5], [-2, 0], [-2, -0.5]]}
"""


def trial() -> float:
    """Record, map and navigate for a few simulated seconds; returns the wall time [s]."""
    watch = Stopwatch()
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            script = folder / "trial.yaml"
            script.write_text(SCRIPT)
            record("turtlebot3_world", "burger", str(script), 0, folder / "record")
            build_map(folder / "record", folder / "map", truth=folder / "record" / "truth")
            goal = Request(
                task="goal",
                seed=0,
                map_path=folder / "map" / "map.yaml",
                initial_pose="start",
                goal=SE2.from_xyt(-1.8, -0.5, 0.0),
            )
            if navigate("turtlebot3_world", goal, folder / "run", say=lambda line: None) != 0:
                raise RuntimeError("the trial drive did not reach its goal 0.2 m ahead")
    finally:
        log.setLevel(before)
    return watch.seconds()
