"""A session of the simulated robot: inputs in, views out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import LONGEST_S, seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_text
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.studio.actions import ACTIONS, map_load
from turtlebag.pipeline.studio.base_session import BaseSession
from turtlebag.pipeline.studio.inputs import DRIVING, Drive, Input, Load, Plain, Save
from turtlebag.pipeline.studio.publisher import Publisher
from turtlebag.pipeline.studio.run import Run, Shared
from turtlebag.pipeline.studio.run_log import RunLogWriter
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.view import Scene, View
from turtlebag.pipeline.studio.visuals import Trails
from turtlebag.sim.robots import static_transforms
from turtlebag.sim.simulator import Simulator


class Session(BaseSession):
    """It owns a simulator and, while one is recorded, a bag."""

    def __init__(self, setup: StudioSetup, folder: Path, say: Callable[[str], None]) -> None:
        """InputError for unknown names and a map that cannot be used."""
        self.setup, self.scene = setup, Scene.of(setup.arena, setup.spec, setup.seed)
        super().__init__(setup.header(), folder, say, setup.map_path)
        publisher, simulator = Publisher(), Simulator(setup.arena, setup.spec, setup.config.sim, setup.seed)
        self._shared = Shared(
            setup=setup,
            simulator=simulator,
            library=self._library,
            run_log=RunLogWriter(folder, simulator, publisher),
            events=self._events,
            publisher=publisher,
            tasks=[],
            trails=Trails(),
        )
        self._run = self._started()
        self._bag: tuple[str, BagWriter] | None = None

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and self._bag is not None:
            self._bag[1].__exit__(kind)
        super().__exit__(kind)
        self._shared.simulator.close()

    def tick(self) -> None:
        """One control period; nothing once the session is over."""
        if self.ended:
            return
        self._journal.tick(self.stamp_ns, self._run.by_hand)
        self._run.tick()
        self._step += 1
        if seconds(self.stamp_ns) >= LONGEST_S:
            self.apply(Plain(do="end"))

    def metrics(self) -> dict[str, Any]:
        """How long it lasted [s], and the metrics of each task."""
        return {"task": "studio", "time_s": round(seconds(self.stamp_ns), 6), "tasks": self._shared.tasks}

    def close(self) -> None:
        """Finish all files; closing twice is harmless."""
        super().close()
        self._shared.run_log.close()
        self._shared.simulator.close()

    def _started(self) -> Run:
        """A run at the spawn, on the map that was given."""
        run = Run(self._shared, self._step)
        if self.setup.map_path is not None:
            map_load(run, Load(do="map_load"))
        return run

    def _done(self, entry: Input) -> str:
        if entry.do in DRIVING:
            asked = Twist(entry.v, entry.w) if isinstance(entry, Drive) else Twist()
            self._run.by_hand = None if entry.do == "release" else asked
            return ""
        if isinstance(entry, Save) and entry.do == "record":
            return self._record(entry.name)
        if entry.do == "record_stop":
            return self._record_stop()
        if entry.do == "reset":
            self._finish("ended: reset")
            self._run = self._started()
            return "reset: the robot is back at its start"
        if entry.do == "end":
            self._finish("ended with the session")
            return "the session is over"
        if entry.do not in ACTIONS:
            raise InputError(f"{entry.do}: no bag is being played; start the studio with --bag BAG")
        return ACTIONS[entry.do](self._run, entry)

    def _finish(self, why: str) -> None:
        self._run.end_task(why)
        if self._bag is not None:
            self._run.say(self._record_stop())

    def _record(self, name: str) -> str:
        if self._bag is not None:
            raise InputError(f"record: {self._bag[0]} is being recorded; stop it first")
        setup, publisher, folder = self.setup, self._shared.publisher, self._folder / "bags" / name
        if folder.exists():
            raise InputError(f"record: a bag {name} already exists; choose another name")
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
        if self._bag is None:
            raise InputError("record_stop: nothing is being recorded")
        name, bag = self._bag
        self._bag = self._shared.publisher.bag = None
        bag.close()
        return f"bag {name} recorded"

    def view(self) -> View:
        """What there is to draw now."""
        run, shared = self._run, self._shared
        pilot, look, truth = run.pilot, run.visuals, shared.simulator.truth
        task, command, trails = pilot.task, run.owner.command, shared.trails
        sequence = None if task is None else task.sequence
        goal = None if sequence is None or sequence.goal is None else sequence.waypoint.written
        return View(
            stamp_ns=run.stamp_ns,
            owner=run.owner.owner,
            command=(command.v, command.w),
            task="" if task is None else task.kind,
            state=run.doing,
            recording=None if self._bag is None else self._bag[0],
            mapping=pilot.mapping,
            map_name=None if run.loaded is None else run.loaded.name,
            maps=shared.library.maps,
            waypoint_files=shared.library.waypoint_files,
            loaded_waypoints=run.waypoints,
            localised=pilot.localised,
            sure=look.sure(),
            lost=look.lost(),
            T_map_base=run.T_map_base,
            T_odom_base=run.observation.odometry.T_odom_base,
            T_world_base=truth.T_world_base,
            goals=look.goals(),
            goal_index=pilot.goal_index,
            goal=goal,
            sectors=look.sectors(),
            events=shared.events.events,
            scan=look.scan(),
            particles=look.particles(),
            plan=look.plan(shared.publisher.path),
            local=look.local(run.T_map_base, command),
            odom_path=trails.odom.path,
            slam_path=trails.slam.path,
            true_path=trails.true.path,
            graph=look.graph(),
            boxes=run.boxes,
            keepout=run.keepout,
            mover_segments=shared.simulator.surroundings.moving.segments,
            mover_circles=shared.simulator.surroundings.moving.circles,
            map=look.map(shared.publisher.grid),
            costmap=look.costmap(),
        )
