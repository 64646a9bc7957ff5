"""The command line: finds the verb's module, runs it, and turns outcomes into exit codes."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from functools import cache
from types import FrameType
from typing import NoReturn

from turtlebag.datasets.errors import InputError, Unfinished
from turtlebag.datasets.files import signatures
from turtlebag.datasets.output_lock import lock_output, release_all
from turtlebag.pipeline.cli.arguments import named_inputs
from turtlebag.pipeline.setup.missing_package import missing_package
from turtlebag.pipeline.stages.parser import Parser, add_action, joined, refuse_former
from turtlebag.pipeline.terminal.interrupts import handled
from turtlebag.pipeline.terminal.messages import Words, guarded_streams, one_line, set_verbosity, show_cursor

# The line of `turtlebag --help` for each verb. STAGES have requests, and are run by `stage`. The module here
# of any other verb has `EXAMPLE`, `add_arguments(parser)` and, unless each action has its own,
# `run(args) -> int`. They are imported only when the verb is used.
VERBS = {
    "record": "drive a simulated robot with a script and record a bag",
    "teleop": "drive with the keyboard and record a bag",
    "studio": "open a simulated robot in the browser: drive, map, set goals",
    "map": "build a map from a bag or log",
    "localise": "localise a recorded robot on a map",
    "identify": "estimate the parameters of a robot from a recording of it",
    "twin": "make a twin of a recording: its building and its robot, and drive it again",
    "navigate": "run a task in closed loop: patrol, goal, avoid or explore",
    "plan": "plan a path on a map",
    "report": "make an HTML report from the outputs of other commands",
    "compare": "compare outputs or runs of the same command, or ours with another system's",
    "grade": "mark a solution of a lesson of the course",
    "sweep": "run a campaign of many cases on all cores; interrupted campaigns resume",
    "board": "run the standard drives with our systems and score them, or score a result of yours",
    "verify": "run a report and its stages again, and compare every file and number",
    "bag": "inspect, play, repair and convert bags",
    "data": "list and fetch public logs",
    "world": "list the built-in worlds, or draw one",
    "doctor": "check the installation",
    "completion": "print a script that completes commands in your shell",
}
STAGES = (
    "record", "teleop", "map", "localise", "identify", "twin", "navigate", "plan", "report", "compare",
    "grade",
)  # fmt: skip

EXIT_OK, EXIT_INPUT = 0, 2


class _Version(argparse.Action):
    """Prints the version; looked up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *unused: object) -> NoReturn:
        from importlib.metadata import version

        print(f"turtlebag {version('turtlebag')}")
        parser.exit()


@cache
def build_parser(*loaded: str | None) -> Parser:
    """The parser; only the named verbs get their arguments, because that imports them."""
    parser = Parser(prog="turtlebag", description="Reproducible SLAM and navigation without ROS.")
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name, summary in VERBS.items():
        if name not in loaded:
            verbs.add_parser(name, help=summary, add_help=False)
            continue
        staged = name in STAGES
        command = importlib.import_module(f"turtlebag.pipeline.cli.{'stage' if staged else name}")
        sub = add_action(verbs, name, summary, command.example(name) if staged else command.EXAMPLE)
        noise = sub.add_mutually_exclusive_group()
        quiet, verbose = ("show only results and errors", "show more detail")
        noise.add_argument(
            "-q", "--quiet", action="store_const", const=-1, dest="verbosity", default=0, help=quiet
        )
        noise.add_argument("-v", "--verbose", action="store_const", const=1, dest="verbosity", help=verbose)
        command.add_arguments(sub, *([name] if staged else []))
        sub.set_defaults(run=getattr(command, "run", None), inputs=getattr(command, "inputs", named_inputs))
    return parser


def parsed(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of one command; InputError for unknown ones."""
    verb = next((word for word in argv if not word.startswith("-")), None)
    refuse_former(verb)
    try:
        return build_parser(verb).parse_args(joined(argv))
    except SystemExit:  # after --help or --version, if that could be written
        sys.stdout.flush()
        raise


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    """End at once on Ctrl-C, SIGTERM or SIGHUP, and leave no incomplete output.

    Nothing is raised: an exception would surface inside running compiled code, which reports it as its own
    error or crashes.
    """
    release_all()
    show_cursor()
    print("turtlebag: interrupted", file=sys.stderr, flush=True)
    os._exit(128 + number)


def _run(args: argparse.Namespace, stdout: Words) -> int:
    """Run a command that is parsed, holding the lock of its output if it has one."""
    set_verbosity(args.verbosity)
    inputs = args.inputs(args)
    out = getattr(args, "out", None)
    if out is None:
        for path in inputs:
            signatures(path)  # no pipes, no devices
        return _done(args)
    stdout.optional = True
    with lock_output(out, force=args.force, inputs=inputs):
        return _done(args)


def _done(args: argparse.Namespace) -> int:
    """Exit code of the command. What a user's part raises is its author's to read: a traceback and exit code
    1, even for an error that we would say in a line, or where it asks Python to exit."""
    try:
        return int(args.run(args))
    except (Exception, SystemExit) as error:
        # Where an output grows, the system's error has become a line by now.
        origin = error.__context__ if isinstance(error, InputError) else error
        parts = sys.modules.get("turtlebag.datasets.parts")  # loaded where there can be parts
        if parts and (origin is error or isinstance(origin, OSError)) and (place := parts.place_of(origin)):
            raise RuntimeError(place) from origin
        raise


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    verb = next((word for word in argv if not word.startswith("-")), None)
    args = argparse.Namespace()
    with guarded_streams() as stdout:
        try:
            with handled(_stop, unless_handled=True):
                if "" in argv:
                    before = "".join(f" after {word}" for word in argv[: argv.index("")][-1:])
                    raise InputError(f"empty argument{before}; is a shell variable unset?")
                args = parsed(argv)
                args.command_line = ["turtlebag", *argv]
                code = _run(args, stdout)
            stdout.flush()
            if stdout.problem:
                print(f"turtlebag: {stdout.problem}; the rest of the output is lost", file=sys.stderr)
            return code
        except InputError as error:
            print(f"turtlebag: {one_line(error)}", file=sys.stderr)
            return error.code if isinstance(error, Unfinished) else EXIT_INPUT
        except ImportError as error:
            print(missing_package(error), file=sys.stderr)
            return EXIT_INPUT
        except BrokenPipeError:
            return EXIT_OK
        except OSError as error:  # a full disk, no permission: the system's own words, in one line
            where = error.filename or getattr(args, "out", None) or verb
            print(f"turtlebag: {one_line(where)}: {one_line(error.strerror or error)}", file=sys.stderr)
            return EXIT_INPUT
        except MemoryError:
            print(f"turtlebag: {verb}: not enough memory for this input", file=sys.stderr)
            return EXIT_INPUT
