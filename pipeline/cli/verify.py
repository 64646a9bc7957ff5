"""turtlebag verify: run a report and its stages again, and compare."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.stages.parser import Parser
from turtlebag.pipeline.terminal.messages import say, starting

EXAMPLE = "turtlebag verify data/report"


def add_arguments(parser: Parser) -> None:
    """Arguments of `turtlebag verify`."""
    parser.option("report", "REPORT", "folder that report wrote", Path)
    parser.option("--only", "KEY", "check one number, named as on the page: WORLD/STAGE:PATH")
    parser.flag("--quick", "run no stage again: compare hashes, and the report with what its stages wrote")
    text = "also run stages again that name parts from outside the package, which runs their code"
    parser.flag("--allow-commands", text)


def run(args: argparse.Namespace) -> int:
    """Print the differences; exit code 1 if there are any, or a stage could not be run again."""
    starting()
    from turtlebag.pipeline.stages.verify import verify

    found = verify(args.report, quick=args.quick, allow_commands=args.allow_commands)
    for other in found.elsewhere:
        say(f"made on another machine or with other packages: {other}")
    if found.elsewhere:
        say("numbers are compared within their tolerances, files are not")
    if args.only is not None:
        matching = [check for check in found.checks if check.key == args.only]
        if not matching and args.only not in found.unchecked:
            raise InputError(f"--only {args.only}: no such number in this report; -v lists them all")
        found.checks, found.problems = matching, [p for p in found.problems if p.startswith(args.only)]
        found.not_run = [line for line in found.not_run if line.startswith(args.only.partition(":")[0])]
    if args.verbosity > 0 or args.only is not None:
        for check in found.checks:
            say(f"{'same' if check.agrees else 'DIFFERS':8}{check.key}  {check.found}")
        if args.only is None:
            for key in found.unchecked:
                say(f"{'skipped':8}{key}")
    for problem in found.problems:
        say(f"DIFFERS {problem}")
    for line in found.not_run:
        say(f"NOT RUN {line}")
    agreeing = sum(check.agrees for check in found.checks)
    say(f"{agreeing} of {len(found.checks)} recomputed numbers agree, {found.files} files hashed")
    if found.unchecked and args.only is None:
        say(f"{len(found.unchecked)} not recomputed: {', '.join(found.unchecked)}")
    return 1 if found.problems or found.not_run else 0
