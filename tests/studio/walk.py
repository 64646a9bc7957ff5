"""A person at the studio: inputs at simulated times, and what came of them as files."""

import filecmp
from contextlib import contextmanager
from pathlib import Path

from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.studio import studio_output
from turtlebag.pipeline.studio.inputs import parse_input
from turtlebag.pipeline.studio.setup import StudioSetup

ROOM = """
name: room
robot: burger
spawn: [-1.2, -0.8, 0.0]
shapes:
  - {kind: box, name: south, z: [0.0, 1.0], center: [0.0, -1.55], size: [4.2, 0.1]}
  - {kind: box, name: north, z: [0.0, 1.0], center: [0.0, 1.55], size: [4.2, 0.1]}
  - {kind: box, name: west, z: [0.0, 1.0], center: [-2.05, 0.0], size: [0.1, 3.2]}
  - {kind: box, name: east, z: [0.0, 1.0], center: [2.05, 0.0], size: [0.1, 3.2]}
  - {kind: box, name: between, z: [0.0, 1.0], center: [0.3, -0.9], size: [0.1, 1.2]}
"""
"""A room of 4 m x 3 m with a wall into it, which is soon explored."""


class Person:
    """Asks a session for things and lets time pass."""

    def __init__(self, session):
        self.session = session
        self.told = []

    def do(self, what, **fields):
        self.told.append(self.session.apply(parse_input({"do": what, **fields})))

    def wait(self, seconds):
        for _ in range(round(seconds * 30)):
            self.session.tick()

    def until_done(self, most_s):
        """Until the task is over; how long that took [s], None when it took too long."""
        for tick in range(round(most_s * 30)):
            if not self.view.task:
                return tick / 30
            self.session.tick()
        return None

    @property
    def view(self):
        return self.session.view()

    @property
    def lines(self):
        return [event.text for event in self.view.events]


@contextmanager
def at_the_studio(out, world="turtlebot3_world", **setup):
    with studio_output(StudioSetup(world, seed=1, **setup), Output(out), say=lambda line: None) as session:
        yield Person(session)


def files(folder):
    """Every file below a folder, but the manifest."""
    found = (path.relative_to(folder) for path in Path(folder).rglob("*") if path.is_file())
    return sorted(path for path in found if path.name != "manifest.json")


def differences(one, other):
    """Files that are not in both folders with the same bytes."""
    names = {*files(one), *files(other)}
    _, wrong, missing = filecmp.cmpfiles(one, other, sorted(names), shallow=False)
    return [str(name) for name in [*wrong, *missing]]


def silent(line):
    """Nobody listens."""
