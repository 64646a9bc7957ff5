"""turtlebag sweep: a campaign of many runs, and queries on its table."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.cli.arguments import output, refuse
from turtlebag.pipeline.stages.parser import Parser, count
from turtlebag.pipeline.terminal.messages import starting

EXAMPLE = "turtlebag sweep advice --out data/studies/advice"


def add_arguments(parser: Parser) -> None:
    """Arguments of `turtlebag sweep`."""
    parser.option("campaign", "FILE", "campaign file, or the name of a built-in study")
    parser.add_output(required=False)
    text = "storage for the workers' results: a folder or an fsspec URL, s3://BUCKET/... (default: --out)"
    parser.option("--store", "URL", text)
    text = "address of a running Dask scheduler (tcp://...), or `threads` to run in this process"
    parser.option("--scheduler", "ADDRESS", text)
    parser.option("--workers", "N", "local processes (default: one per core)", count)
    parser.flag("--allow-commands", "run the programs that the campaign file names; read it first")
    text = "run an SQL query on the table `runs` of a finished campaign; FILE is then its folder or its store"
    parser.option("--query", "SQL", text)


def run(args: argparse.Namespace) -> int:
    """Run the campaign and print its page's path, or answer a query."""
    if args.query is not None:
        running = ("out", "force", "store", "scheduler", "workers", "allow_commands")
        refuse(args, running, "cannot be used with --query; remove it")
        return _answer(args.campaign, args.query)
    if args.out is None:
        raise InputError("sweep: --out DIR is needed")
    starting()
    from turtlebag.pipeline.campaign.sweep import sweep

    code = sweep(
        args.campaign,
        output(args),
        store=args.store,
        scheduler=args.scheduler,
        workers=args.workers,
        allow_commands=args.allow_commands,
    )
    print(args.out / "index.html")
    return code


def _answer(place: str, sql: str) -> int:
    from turtlebag.pipeline.campaign.store import Store
    from turtlebag.pipeline.campaign.table import query
    from turtlebag.pipeline.terminal.messages import one_line
    from turtlebag.reports.stages import read_json

    manifest = Path(place, "manifest.json")
    store = read_json(manifest).get("store", place) if manifest.is_file() else place
    names, rows = query(Store(str(store)), sql)
    print("\t".join(map(one_line, names)))
    for row in rows:
        print("\t".join("" if value is None else one_line(value) for value in row))
    return 0
