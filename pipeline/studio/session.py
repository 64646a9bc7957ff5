"""A session: the simulated robot and what a person asks of it. No clock, no network, no thread."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import LONGEST_S
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_text
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.navigation.recorder import NoBag
from turtlebag.pipeline.studio import inputs
from turtlebag.pipeline.studio.actions import ACTIONS, map_load
from turtlebag.pipeline.studio.journal import FILE, Journal
from turtlebag.pipeline.studio.library import Library
from turtlebag.pipeline.studio.publisher import Publisher
from turtlebag.pipeline.studio.run import Room, Run
from turtlebag.pipeline.studio.run_log import RunLogWriter
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.view import Scene, View
from turtlebag.pipeline.studio.visuals import EventLog, Trail
from turtlebag.sim.robots import static_transforms
from turtlebag.sim.simulator import CONTROL_HZ, Simulator


class Session:
    """A context manager: it owns a simulator and, while one is recorded, a bag."""

    period_ns = round(1e9 / CONTROL_HZ)
    """From a tick to the next [ns]."""

    def __init__(self, setup: StudioSetup, folder: Path, say: Callable[[str], None]) -> None:
        """`folder` is where everything is written; `say` is told each line of the event log.

        InputError for unknown names and a map that cannot be used.
        """
        self.setup, self._folder = setup, folder
        self.scene = Scene.of(setup.arena, setup.spec, setup.seed)
        header, library = setup.header(), Library(folder, setup.map_path)
        publisher, simulator = Publisher(), Simulator(setup.arena, setup.spec, setup.config.sim, setup.seed)
        self._room = Room(
            setup=setup,
            simulator=simulator,
            library=library,
            run_log=RunLogWriter(folder, simulator, publisher),
            events=EventLog(say),
            publisher=publisher,
            tasks=[],
            trails={name: Trail() for name in ("odom", "slam", "true")},
        )
        self._step = 0
        self._run = self._started()
        self._journal = Journal(folder / FILE, header)
        self._bag: tuple[str, BagWriter] | None = None
        self.ended = False
        """Whether it was asked to end."""

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:  # nothing of it is kept
            self._room.simulator.close()

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]."""
        return self._run.stamp_ns

    def interrupt(self) -> None:
        """Nothing that is done here can be broken off."""

    idle = False
    """Whether time stands still whatever is asked for."""

    def apply(self, entry: inputs.Input) -> str:
        """Do what is asked for at this instant, before the tick; returns a line for the event log.

        It stands in the log already, and is empty where there is nothing to tell. InputError, with nothing
        changed, when that cannot be done.
        """
        if self.ended:
            raise InputError(f"{entry.do}: the session is over")
        if isinstance(entry, inputs.Driving):
            return self._drive(entry)
        try:
            line = self._done(entry)
        except OSError as error:
            raise InputError(f"{entry.do}: {error.filename}: {error.strerror}") from None
        self._journal.action(self.stamp_ns, entry)
        if line:
            self._run.say(line)
        return line

    def tick(self) -> None:
        """One control period; nothing once the session is over."""
        if self.ended:
            return
        self._journal.tick(self.stamp_ns, self._run.hands.command)
        self._run.tick()
        self._step += 1
        if self.stamp_ns >= LONGEST_S * 1e9:
            self.apply(inputs.End())

    def metrics(self) -> dict[str, Any]:
        """How long it lasted [s], and the metrics of each task."""
        return {"task": "studio", "time_s": round(self.stamp_ns * 1e-9, 6), "tasks": self._room.tasks}

    def close(self) -> None:
        """Finish all files; closing twice is harmless."""
        if not self.ended:
            self.apply(inputs.End())
        self._journal.close()
        self._room.run_log.close()
        self._room.simulator.close()

    def _started(self) -> Run:
        """A run at the spawn, on the map that was given."""
        run = Run(self._room, self._step)
        if self.setup.map_path is not None:
            map_load(run, inputs.MapLoad())
        return run

    def _drive(self, entry: inputs.Driving) -> str:
        hands = self._run.hands
        if isinstance(entry, inputs.Release):
            hands.command = None
        else:
            hands.command = Twist(entry.v, entry.w) if isinstance(entry, inputs.Drive) else Twist()
        return ""

    def _done(self, action: inputs.Action) -> str:
        if isinstance(action, inputs.Record):
            return self._record(action.name)
        if isinstance(action, inputs.RecordStop):
            if self._bag is None:
                raise InputError("record_stop: nothing is being recorded")
            return self._record_stop()
        if isinstance(action, inputs.Reset):
            self._finish("ended: reset")
            self._run = self._started()
            return "reset: the robot is back at its start"
        if isinstance(action, inputs.End):
            self._finish("ended with the session")
            self.ended = True
            return "the session is over"
        if type(action) not in ACTIONS:
            raise InputError(f"{action.do}: no bag is being played; start the studio with --bag BAG")
        return ACTIONS[type(action)](self._run, action)

    def _finish(self, why: str) -> None:
        self._run.end_task(why)
        if self._bag is not None:
            self._run.say(self._record_stop())

    def _record(self, name: str) -> str:
        if self._bag is not None:
            raise InputError(f"record: {self._bag[0]} is being recorded; stop it first")
        setup, publisher, folder = self.setup, self._room.publisher, self._folder / "bags" / name
        if folder.exists():
            raise InputError(f"record: there is a bag {name} already; choose another name")
        custom = {
            "seed": str(setup.seed),
            "config_sha256": sha256_text(config_text(setup.config)),
            "world": setup.arena.name,
            "task": "studio",
        }
        bag = BagWriter(folder, custom=custom)
        self._bag, publisher.bag = (name, bag), bag
        bag.static_transforms(self.stamp_ns, static_transforms(setup.spec))
        if publisher.grid is not None:
            bag.map(self.stamp_ns, publisher.grid)
        if self._run.owner.owner == "teleop":
            bag.owner(self.stamp_ns, "teleop")
        return f"recording {name}"

    def _record_stop(self) -> str:
        assert self._bag is not None
        name, bag = self._bag
        bag.close()
        self._bag, self._room.publisher.bag = None, NoBag()
        return f"bag {name} recorded"

    def view(self) -> View:
        """What there is to draw now."""
        run, room = self._run, self._room
        pilot, look, truth = run.pilot, run.visuals, room.simulator.truth
        task = pilot.task
        sequence = None if task is None else task.sequence
        goal = None
        if sequence is not None and sequence.goal is not None:
            goal = sequence.waypoint.written
        return View(
            stamp_ns=run.stamp_ns,
            ended=self.ended,
            owner=run.owner.owner,
            command=(run.command.v, run.command.w),
            task="" if task is None else task.kind,
            state=run.doing,
            recording=None if self._bag is None else self._bag[0],
            mapping=pilot.mapping,
            map_name=run.map_name,
            maps=room.library.maps,
            waypoint_files=room.library.waypoint_files,
            loaded_waypoints=run.waypoints,
            localised=pilot.localised,
            sure=look.sure(),
            lost=look.lost(),
            T_map_base=run.T_map_base,
            T_odom_base=run.observation.odometry.T_odom_base,
            T_world_base=truth.T_world_base,
            goals=look.goals(run.shown),
            goal_index=pilot.goal_index,
            goal=goal,
            sectors=look.sectors(),
            events=room.events.events,
            scan=look.scan(),
            particles=look.particles(),
            plan=look.plan(room.publisher.path),
            local=look.local(run.T_map_base, run.command),
            odom_path=room.trails["odom"].path,
            slam_path=room.trails["slam"].path,
            true_path=room.trails["true"].path,
            graph=look.graph(),
            boxes=run.boxes,
            keepout=run.keepout,
            mover_segments=room.simulator.moving.segments,
            mover_circles=room.simulator.moving.circles,
            map=look.map(room.publisher.grid),
            costmap=look.costmap(),
        )
