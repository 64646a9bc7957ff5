"""A bag or log that is played: raw by its odometry, through the online mapper, or mapped as a whole.

Simulated time only moves forward, so that `session.yaml` can be replayed; inputs set the position in the bag.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Scan, Stamps, Trajectory
from turtlebag.pipeline.slam.graph.edits import AddedLoop, Edits, KeyEdits, RejectedLoop
from turtlebag.pipeline.slam.mapper import run_slam
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.pipeline.slam.online.memory import heard
from turtlebag.pipeline.studio import inputs
from turtlebag.pipeline.studio.drawn_map import Drawn
from turtlebag.pipeline.studio.inputs import LONGEST_BAG_S
from turtlebag.pipeline.studio.library import Library
from turtlebag.pipeline.studio.loops_shown import graph_of_mapper, points_of
from turtlebag.pipeline.studio.setup import BagSetup
from turtlebag.pipeline.studio.view import BagMarks, EditMark, Level, LoopMarks, MapLayer, View
from turtlebag.pipeline.studio.visuals import Cached, EventLog, Trail
from turtlebag.sim.robots import stamp_of

EDITS = "edits.yaml"
NO_KEYS = np.zeros(0, dtype=np.int64)
DRAWN_EVERY = 60
"""Ticks between map updates while mapping: two seconds of the bag."""
ROUNDED_S = 0.1
"""A seek may lie this far beyond the end of the bag, because pages round times."""


@dataclass(frozen=True, eq=False)
class Online:
    """Online mapping from scan `first` on; `waiting` are the scans still to come."""

    mapper: Mapper
    first: int
    waiting: Iterator[tuple[Scan, SE2 | Trajectory | None]]


class Playhead:
    """Where a bag is played: `position_ns` after its start, and the newest scan by then, -1 for none."""

    def __init__(self, stamps_ns: Stamps) -> None:
        # logs whose clock goes back keep their order
        self._at_ns = np.maximum.accumulate(stamps_ns) - stamps_ns[0]
        self.end_ns = int(self._at_ns[-1])
        self.position_ns, self.scan = 0, -1

    @property
    def at_end(self) -> bool:
        """Whether there is no further scan."""
        return self.scan == len(self._at_ns) - 1

    def forward(self, position_ns: int) -> Iterator[int]:
        """The scans up to there, one by one."""
        self.position_ns = min(position_ns, self.end_ns)
        while not self.at_end and self._at_ns[self.scan + 1] <= self.position_ns:
            self.scan += 1
            yield self.scan

    def seek(self, position_ns: int) -> Iterator[int]:
        """Play from there on: the scan there, as in `forward`."""
        self.scan = int(np.searchsorted(self._at_ns, min(position_ns, self.end_ns), side="right")) - 2
        return self.forward(position_ns)


class Playback:
    """Plays a bag, which has no robot to drive."""

    by_hand = None
    longest_s = LONGEST_BAG_S

    def __init__(self, setup: BagSetup, folder: Path, events: EventLog) -> None:
        """InputError for a bag that cannot be mapped."""
        self._log, self._config = setup.recording, setup.config
        self._folder, self._events = folder, events
        self._library = Library(folder, None)
        self._step = 0
        self._head = Playhead(self._log.stamps_ns)
        self._edits = Edits()
        self._online: Online | None = None
        self._drawn: Drawn | None = None
        self._built: Drawn | None = None
        """The last map of the whole bag."""
        self._interrupted = False
        self._loop: LoopMarks | None = None
        self._trails = {"odom": Trail(), "slam": Trail()}
        self._cached = Cached()
        for note in self._log.notes:
            self.say(note)
        if setup.edits != Edits():
            setup.edits.require_scans(len(self._log), self._log.source)
            self._edited(setup.edits, "")

    @property
    def stamp_ns(self) -> int:
        """Simulated time since the session began [ns]."""
        return stamp_of(self._step)

    @property
    def idle(self) -> bool:
        """Whether time stands still: the bag is at its end."""
        return self._head.at_end

    def tick(self) -> None:
        """One control period of the bag."""
        self._step += 1
        self._play(self._head.forward(self._head.position_ns + stamp_of(1)))
        if self.idle or self._step % DRAWN_EVERY == 0:
            self._draw()
        if self.idle:
            self.say("the bag is at its end")

    def interrupt(self) -> None:
        """Break off the mapping of the whole bag that may be under way; called from another thread."""
        self._interrupted = True

    def _until_interrupted(self, items: Iterable[int], description: str, total: int) -> Iterable[int]:
        for item in items:
            if self._interrupted:
                raise InputError(f"{description}: cancelled")
            yield item

    def metrics(self) -> dict[str, Any]:
        """How much of the bag was played."""
        return {"scans": len(self._log), "played": self._head.scan + 1}

    def say(self, text: str, level: Level = "info") -> None:
        """A line for the event log, at the time of the bag."""
        self._events.add(self._head.position_ns, text, level)

    def close(self, failure: type[BaseException] | None = None) -> None:
        """All files are finished already."""

    def act(self, entry: inputs.Input) -> str:
        """Do what is asked for; returns what there is to tell of it. InputError when it cannot be done."""
        match entry:
            case inputs.Plain(do="stop" | "release"):
                return ""
            case inputs.Plain(do="map_start"):
                return self._map_start()
            case inputs.Plain(do="map_stop"):
                return self._map_stop()
            case inputs.Plain(do="map_build"):
                return self._build()
            case inputs.Save(do="map_save"):
                return self._map_save(entry.name)
            case inputs.Plain(do="edits_clear"):
                return self._edited(Edits(), "edits cleared")
            case inputs.Plain(do="wall_undo"):
                return self._undo()
            case inputs.Wall():
                return self._wall(entry)
            case inputs.LoopAdd():
                return self._add(entry)
            case inputs.Scans(do="loop_show"):
                return self._show(entry)
            case inputs.Scans():
                return self._reject(entry)
            case inputs.Seek():
                return self._seek(entry.t)
            case inputs.Plain(do="reset"):
                return self._seek(0.0)
            case inputs.Plain(do="end"):
                return "the session is over"
        raise InputError(f"{entry.do}: not possible while a bag is played; there is no robot")

    # Where in the bag

    def _seek(self, t: float) -> str:
        """Play from there on; the online mapper stops, because it has not seen the part in between."""
        end_s = seconds(self._head.end_ns)
        if t > end_s + ROUNDED_S:
            raise InputError(f"seek: the bag ends after {end_s:.1f} s")
        self._online = None
        self._trails["odom"].clear()
        self._play(self._head.seek(nanoseconds(t)))
        return ""

    def _play(self, scans: Iterable[int]) -> None:
        for k in scans:
            if self._online is not None:
                mapper, (scan, odometry) = self._online.mapper, next(self._online.waiting)
                jumps = len(mapper.jumps)
                T_map_base = mapper.add(scan, odometry)
                if len(mapper.jumps) > jumps:
                    self._draw()
                else:
                    self._trails["slam"].add(T_map_base.xy)
            if self._log.T_odom_base is not None:
                self._trails["odom"].add(self._log.T_odom_base[k].xy)

    # Mapping

    def _map_start(self) -> str:
        if self._online is not None:
            raise InputError("map_start: mapping is already running")
        if self.idle:
            raise InputError("map_start: end of the bag; go back first")
        mapper, first = (
            Mapper(self._log.lidar, self._log.T_base_lidar, others=self._log.others),
            self._head.scan + 1,
        )
        self._online = Online(mapper, first, heard(self._log, first))
        self._drawn = self._loop = None
        self._trails["slam"].clear()
        return "mapping from here on"

    def _map_stop(self) -> str:
        if self._online is None:
            raise InputError("map_stop: mapping is not running")
        self._draw()
        self._online = None
        return "mapping stopped"

    def _draw(self) -> None:
        """The online map, if there is one, its graph and its path."""
        if self._online is None or len(self._online.mapper) < 2:
            return
        mapper = self._online.mapper
        graph = graph_of_mapper(mapper, self._online.first)
        self._drawn = Drawn(MapLayer(mapper.map()), graph, mapper.T_map_odom, self._log)
        self._trails["slam"].replace(mapper.trajectory.poses.xy)

    def _build(self) -> str:
        """Map the whole bag, with the edits."""
        if self._built is not None and self._built.edits == self._edits and self._drawn is self._built:
            return "the map of the whole bag is already shown"
        try:
            result = run_slam(self._log, self._config, self._until_interrupted, edits=self._edits.loops)
        except InputError as error:
            raise InputError(str(error).removeprefix("--edits: ")) from None
        built = Drawn.of(result, self._edits)
        self._explain(built)
        self._drawn = self._built = built
        self._online = self._loop = None
        self._trails["slam"].replace(result.trajectory.poses.xy)
        refused = 0
        for added, loop in zip(self._edits.add, result.loops, strict=False):
            if not loop.accepted:
                text = f"scan {added.scan} at scan {added.place}: not joined: {loop.verdict}"
                self.say(text, "warning")
                refused += 1
        told = f"{result.check.verdict} map of {len(result.trajectory)} scans, {len(built.graph.loops)} loops"
        return f"{told}; {refused} of the added loops rejected" if refused else told

    def _explain(self, built: Drawn) -> None:
        """Say why there are loops that the map before did without, after one was rejected."""
        before = self._built
        if before is None or built.edits.reject == before.edits.reject:
            return
        more = len(built.graph.pairs - before.graph.pairs)
        if more:
            self.say(
                f"{counted(more, 'other loop')} instead of the rejected one: without it the path there is "
                "less certain, so the mapper tries places that it did not need before. Reject those that are "
                "wrong as well"
            )

    def _map_save(self, name: str) -> str:
        """Save the map of the whole bag, built first if the edits have changed."""
        self._library.check_name(name)
        if self._built is None or self._built.edits != self._edits:
            self.say(self._build())
        assert self._built is not None
        self._library.save_map(name, self._built.layer.grid, ())
        return f"map {name} saved"

    # Loops

    def _show(self, action: inputs.Scans) -> str:
        if self._drawn is None:
            raise InputError("loop_show: no graph yet; map the bag first")
        self._loop = self._drawn.graph.laid(self._drawn.log, action.scan, action.place, self._drawn.motion)
        return ""

    def _reject(self, action: inputs.Scans) -> str:
        edits, pair = self._edits, f"the loop of scans {action.scan} and {action.place}"
        added = tuple(x for x in edits.add if {x.scan, x.place} != {action.scan, action.place})
        if len(added) < len(edits.add):
            return self._edited(edits.model_copy(update={"add": added}), f"{pair} is not added")
        rejected = (*edits.reject, RejectedLoop(scan=action.scan, place=action.place))
        return self._edited(edits.model_copy(update={"reject": rejected}), f"{pair} is rejected")

    def _add(self, action: inputs.LoopAdd) -> str:
        loop = AddedLoop(scan=action.scan, place=action.place, pose=action.pose)
        edits = self._edits.model_copy(update={"add": (*self._edits.add, loop)})
        return self._edited(edits, f"scans {action.scan} and {action.place} are to be joined")

    # Walls

    def _wall(self, action: inputs.Wall) -> str:
        if self._drawn is None:
            raise InputError(f"{action.do}: map the whole bag first")
        walls = (*self._edits.walls, self._drawn.wall(action))
        line = "wall drawn" if action.do == "wall_draw" else "wall erased"
        return self._edited(self._edits.model_copy(update={"walls": walls}), line)

    def _undo(self) -> str:
        if not self._edits.walls:
            raise InputError("wall_undo: no wall was drawn or erased")
        walls = self._edits.walls[:-1]
        return self._edited(self._edits.model_copy(update={"walls": walls}), "the last wall is undone")

    def _edited(self, edits: Edits, line: str) -> str:
        """Keep the edits, on disk at once; walls are shown at once, too, as they move no scan."""
        built = self._built
        try:
            edits.require_scans(len(self._log), self._log.source)
            if built is not None:
                KeyEdits.of(edits, built.graph.keys, len(self._log))
                built = built.with_walls(edits.walls)
        except InputError as error:
            raise InputError(str(error).removeprefix("--edits: ")) from None
        told = edits.model_dump(mode="json", exclude_defaults=True)
        text = yaml.safe_dump({"version": 1, **told}, sort_keys=False, default_flow_style=None)
        partial = self._folder / f".{EDITS}"
        partial.write_text(text)
        partial.replace(self._folder / EDITS)
        moved = edits.loops != self._edits.loops
        if self._drawn is self._built:
            self._drawn = built
        self._edits, self._built = edits, built
        return f"{line}; map the bag again to see it" if moved else line

    # Drawing

    def view(self) -> View:
        """What there is to draw now."""
        T_odom_base = SE2.identity()
        if self._log.T_odom_base is not None:
            T_odom_base = self._log.T_odom_base[max(self._head.scan, 0)]
        T_map_base = self._pose(T_odom_base)
        drawn, mapper = self._drawn, None if self._online is None else self._online.mapper
        return View(
            stamp_ns=self._head.position_ns,
            state="mapping" if mapper is not None else "at its end" if self.idle else "playing",
            mapping=mapper is not None,
            maps=self._library.maps,
            sure=mapper.fit if mapper is not None and len(mapper) else None,
            lost="scans do not fit the map" if mapper is not None and mapper.lost else None,
            T_map_base=T_map_base,
            T_odom_base=T_odom_base,
            T_world_base=T_map_base,
            events=self._events.events,
            scan=self._points(T_map_base),
            odom_path=self._trails["odom"].path,
            slam_path=self._trails["slam"].path,
            graph=None if drawn is None else drawn.graph.graph,
            map=None if drawn is None else drawn.layer,
            bag=self._marks(),
        )

    def _pose(self, T_odom_base: SE2) -> SE2:
        """The best estimate of where the newest scan was taken."""
        drawn, scan = self._drawn, self._head.scan
        if self._online is not None and len(self._online.mapper):
            return self._online.mapper.T_map_base
        if drawn is not None and drawn.result is not None and scan >= 0:
            return drawn.result.trajectory.poses[scan]
        return T_odom_base if drawn is None else drawn.T_map_odom @ T_odom_base

    def _points(self, T_map_base: SE2) -> Array | None:
        scan = self._head.scan
        if scan < 0:
            return None
        drawn = self._drawn
        log, motion = (self._log, None) if drawn is None else (drawn.log, drawn.motion)
        of = (log, scan, *T_map_base.xyt.tolist())
        return self._cached.get("scan", of, lambda: T_map_base @ points_of(log, scan, motion))

    def _marks(self) -> BagMarks:
        edits = [EditMark("reject", loop.scan, loop.place) for loop in self._edits.reject]
        edits += [EditMark("add", loop.scan, loop.place) for loop in self._edits.add]
        edits += [EditMark(wall.do, wall.scan or 0) for wall in self._edits.walls]
        keys = NO_KEYS if self._drawn is None else self._drawn.graph.keys
        position_s, end_s = seconds(self._head.position_ns), seconds(self._head.end_ns)
        return BagMarks(position_s, end_s, keys, self._loop, tuple(edits))
