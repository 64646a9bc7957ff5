"""The stage `studio`: a session that a person drives, and its replay from `session.yaml`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.navigation.teleop_override import Script
from turtlebag.pipeline.stages.requests.studio import StudioRequest
from turtlebag.pipeline.studio.inputs import Drive, Input, Plain
from turtlebag.pipeline.studio.journal import load_session
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import BagSetup, StudioSetup, setup_of
from turtlebag.pipeline.terminal.interrupts import deferred_interrupt
from turtlebag.pipeline.terminal.messages import log, say, simulated_time


@contextmanager
def studio_output(
    setup: StudioSetup | BagSetup,
    out: Output,
    *,
    say: Callable[[str], None] = say,
    session_file: Path | None = None,
) -> Iterator[Session]:
    """A session whose files grow in OUT.partial and are put in place when the block is left.

    A session that did not end within the block ends there. `say` takes the lines of the event log,
    `session_file` is the one that is replayed. InputError, with nothing written, for unknown names and
    unreadable maps.
    """
    files = {**setup.files, **({} if session_file is None else {"session": session_file})}
    by_hand = session_file is None  # only what a person did cannot be done again
    with out.staged(files.values(), save_bag=by_hand) as folder:
        with Session(setup, folder, say) as session:
            yield session
        about = {}
        if isinstance(setup, StudioSetup):
            save_map(setup.arena.rasterize(setup.spec.lidar_height), folder / "truth")
            about = {"world": setup.arena.name, "robot": setup.spec.name}
        simulated_s = seconds(session.stamp_ns)
        pace = {"realtime_factor": round(simulated_s / max(out.wall_s, 1e-9), 2)}
        out.finish(
            folder,
            "studio",
            files,
            metrics=session.metrics(),
            config=config_text(setup.config),
            seed=setup.seed if isinstance(setup, StudioSetup) else None,
            extra={**about, "out": str(out.folder), **pace},
        )
    log.info(f"{simulated_s:.1f} simulated seconds -> {out.folder}")


def replay_as_asked(request: StudioRequest, out: Output) -> int:
    """Replay the session that a request names; the exit code of `replay`."""
    return replay(request.replayed(), out, say=log.info)


def replay(session_file: Path, out: Output, *, say: Callable[[str], None] = say) -> int:
    """Replay a session to the same bytes; returns the exit code.

    A session that was killed, so that its file has no `end`, ends with the last line of the file.
    InputError, with nothing written, when it cannot be replayed.
    """
    recorded = load_session(session_file)
    setup = setup_of(recorded.header, session_file)
    actions, script = deque(recorded.actions), Script(recorded.script)
    with (
        deferred_interrupt() as interrupted,
        studio_output(setup, out, say=say, session_file=session_file) as session,
        simulated_time(seconds(recorded.until_ns)) as clock,
    ):
        while not session.ended:
            now = session.stamp_ns
            # where a bag is at its end the time stands still: the next action comes at once
            while actions and (actions[0][0] <= now or session.idle):
                _apply(session, actions.popleft()[1], session_file)
            asked = script.asked(now)
            if session.ended:
                break
            session.apply(Plain(do="release") if asked is None else Drive(v=asked.v, w=asked.w))
            if interrupted or (not actions and (now >= recorded.until_ns or session.idle)):
                session.apply(Plain(do="end"))
            session.tick()
            clock(now, "")
    if interrupted:
        log.warning("interrupted; the session so far is kept")
    return 128 + interrupted[0] if interrupted else 0


def _apply(session: Session, action: Input, session_file: Path) -> None:
    try:
        session.apply(action)
    except InputError as error:
        raise InputError(f"{session_file}: at {seconds(session.stamp_ns):g} s: {error}") from None
