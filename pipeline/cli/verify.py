"""turtlebag verify: recompute a report's numbers."""

from __future__ import annotations

import argparse
import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.stages.parser import Parser

EXAMPLE = "turtlebag verify data/report"


def add_arguments(parser: Parser) -> None:
    """Arguments of `turtlebag verify`."""
    parser.option("report", "REPORT", "folder that report wrote", Path)
    parser.option("--only", "KEY", "check one number, named as on the page: WORLD/STAGE:PATH")
    parser.flag("--quick", "skip the numbers that need map, localise or plan to run again")


def run(args: argparse.Namespace) -> int:
    """Print the differences; exit code 1 if there are any."""
    from turtlebag.pipeline.stages.verify import verify

    found = verify(args.report, None if args.quick else _run_silently)
    if args.only is not None:
        matching = [check for check in found.checks if check.key == args.only]
        if not matching:
            raise InputError(f"--only {args.only}: no such number in this report; -v lists them all")
        found.checks, found.problems = matching, [p for p in found.problems if p.startswith(args.only)]
    if args.verbosity > 0 or args.only is not None:
        for check in found.checks:
            print(f"{'same' if check.agrees else 'DIFFERS':8}{check.key}  {check.found}")
        if args.only is None:
            for key in found.unchecked:
                print(f"{'skipped':8}{key}")
    for problem in found.problems:
        print(f"DIFFERS {problem}")
    for note in found.notes:
        print(note)
    agreeing = sum(check.agrees for check in found.checks)
    print(f"{agreeing} of {len(found.checks)} recomputed numbers agree, {found.files} files hashed")
    if found.unchecked and args.only is None:
        print(f"{len(found.unchecked)} not recomputed: {', '.join(found.unchecked)}")
    return 1 if found.problems else 0


def _run_silently(words: list[str]) -> int:
    """Run a command line without its output, which is not for the reader of a verification."""
    from turtlebag.pipeline.cli.main import main
    from turtlebag.pipeline.terminal.messages import verbosity_kept

    with verbosity_kept(), redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
        return main([*words, "--quiet"])
