"""`turtlebag studio`."""

from __future__ import annotations

import argparse
import os
import re
import shlex
from collections.abc import Iterable, Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from turtlebag.datasets.errors import InputError, Unfinished
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.cli.arguments import output
from turtlebag.pipeline.stages.command_line import add_request, flag_of_field, request_of
from turtlebag.pipeline.stages.parser import Parser
from turtlebag.pipeline.stages.requests.studio import StudioRequest

if TYPE_CHECKING:
    from socket import socket

    from turtlebag.pipeline.studio.access import Access
    from turtlebag.pipeline.studio.session import Session
    from turtlebag.pipeline.studio.setup import BagSetup, StudioSetup

EXAMPLE = StudioRequest.EXAMPLE
LOOPBACK = "127.0.0.1"
SIMULATED = ("world", "robot", "seed", "map", "config", "settings")
LIVE = (*SIMULATED, "bag", "edits", "port", "host")
"""Fields that a replay does not take, because the session file has them."""


def add_arguments(parser: Parser) -> None:
    """The command's arguments."""
    add_request(parser, StudioRequest)
    text = "folder for everything that is saved (default: data/studio/WORLD-ROBOT-SEED)"
    parser.add_output(text, required=False)


def inputs(args: argparse.Namespace) -> list[Path]:
    """What the session may read; the request of the arguments is made here."""
    args.request = request_of(StudioRequest, args)
    return args.request.files()


def run(args: argparse.Namespace) -> int:
    """Serve the page until the session ends or Ctrl-C, or replay a session."""
    request: StudioRequest = args.request
    if request.session is not None:
        return _replay(request, args)
    from turtlebag.pipeline.slam.graph.edits import Edits, load_edits
    from turtlebag.pipeline.stages.record import RecordOptions
    from turtlebag.pipeline.stages.settings import load_config
    from turtlebag.pipeline.studio.access import Access, is_loopback, listen, new_token
    from turtlebag.pipeline.studio.setup import BagSetup, StudioSetup
    from turtlebag.pipeline.terminal.messages import log

    setup: StudioSetup | BagSetup
    if request.bag is not None:
        _refuse(request, SIMULATED, "cannot be used with --bag, where nothing is simulated; remove it")
        setup = BagSetup(request.bag, edits=Edits() if request.edits is None else load_edits(request.edits))
        words: tuple[str, ...] = (request.bag.name,)
    else:
        _refuse(request, ("edits",), "edits the map of a bag; give --bag, too")
        options = load_config(RecordOptions, request.config, request.settings)
        setup = StudioSetup(request.world, request.robot, request.seed, request.map, options.sim)
        words = (Path(setup.world).stem, Path(setup.robot_name).stem, str(setup.seed))
    out = args.out or _free_folder(words)
    host = request.host or LOOPBACK
    sockets = listen(host, request.port or 0)
    access = Access(new_token(), host, sockets[0].getsockname()[1])
    if not is_loopback(host):
        log.warning(
            f"--host {host}: anyone who can reach this machine and knows the page's address can drive the "
            "robot and save below --out; nothing is encrypted"
        )
    return _live(setup, out, access, sockets, args)


def _live(
    setup: StudioSetup | BagSetup, out: Path, access: Access, sockets: list[socket], args: argparse.Namespace
) -> int:
    import asyncio

    from turtlebag.pipeline.stages.studio import studio_output
    from turtlebag.pipeline.studio.server import serve
    from turtlebag.pipeline.terminal.interrupts import deferred_interrupt, require_no_hangup
    from turtlebag.pipeline.terminal.messages import log, say

    def ready() -> None:
        say(access.url)
        log.info("Ctrl-C ends the session")
        if args.request.browser:
            _open_browser(access.url)

    failure: Exception | None = None
    # The same session cannot be driven by hand again, so after an interrupt or a failure it is finished and
    # kept.
    with (
        deferred_interrupt() as interrupted,
        studio_output(setup, Output(out, args.force, args.command_line), say=log.info) as session,
    ):
        try:
            live = serve(
                session,
                access,
                sockets,
                interrupted=interrupted,
                ready=ready,
                after=lambda: _after(out, setup, session),
            )
            asyncio.run(live)
            session.close()
            require_no_hangup(interrupted)
        except (OSError, Unfinished):  # a full disk: the output cannot be finished, what there is is kept
            raise
        except Exception as error:
            failure = error
            log.error(f"the session failed; its data are kept in {out}")
    if failure is not None:
        raise failure
    return 128 + interrupted[0] if interrupted else 0


def _after(out: Path, setup: StudioSetup | BagSetup, session: Session) -> list[str]:
    """Where the files of a session are, and commands: map and report on the bag, replay the session."""
    from turtlebag.pipeline.studio.setup import BagSetup

    bag, edits = next((out / "bags" / name for name in reversed(session.view().bags)), None), ""
    if isinstance(setup, BagSetup):
        bag = setup.bag
        marks = session.view().bag
        if marks is not None and marks.edits:
            edits = f" --edits {shlex.quote(str(out / 'edits.yaml'))}"
    mapped, page, recorded, again = map(
        shlex.quote, (f"{out}-map", f"{out}-report", f"{out / 'session.yaml'}", f"{out}-again")
    )
    lines = [f"Its files are in {out.resolve()}"]
    if bag is not None:
        lines.append(f"turtlebag map {shlex.quote(str(bag))}{edits} --out {mapped}")
        lines.append(f"turtlebag report {mapped} --out {page}")
    return [*lines, f"turtlebag studio --replay {recorded} --out {again}"]


def _replay(request: StudioRequest, args: argparse.Namespace) -> int:
    from turtlebag.pipeline.stages.run import run as run_stage

    _refuse(request, LIVE, "cannot be used with --replay, which takes it from the session; remove it")
    if args.out is None:
        raise InputError("--replay: needs --out DIR, the folder to write the session to")
    return run_stage(request, output(args))


def _refuse(request: StudioRequest, names: Iterable[str], why: str) -> None:
    """InputError for the first of these fields that was given."""
    for name in names:
        if name in request.model_fields_set:
            raise InputError(f"{flag_of_field(request, name)}: {why}")


def _free_folder(words: Sequence[str]) -> Path:
    """The first folder of that name that neither exists nor is being written."""
    name = "-".join(re.sub(r"[^A-Za-z0-9_]+", "_", word) for word in words)
    folders = (Path("data/studio") / f"{name}{'' if k == 1 else f'-{k}'}" for k in count(1))
    return next(f for f in folders if not (f.exists() or f.with_name(f"{f.name}.partial").exists()))


def _open_browser(url: str) -> None:
    """Open the page if there is a display: a browser in the terminal would take its place."""
    import sys
    import threading
    import webbrowser

    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY", "BROWSER"} & set(os.environ):
        return
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
