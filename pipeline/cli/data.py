"""`turtlebag data`: the public logs and worlds of the registry."""

from __future__ import annotations

import argparse

from turtlebag.datasets.registry import DATASETS, MIRROR_VARIABLE, Dataset, fetch
from turtlebag.pipeline.stages.parser import Parser, add_action

EXAMPLE = "turtlebag data fetch intel"


def add_arguments(parser: Parser) -> None:
    """The actions and their arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    text = "list the logs and worlds with their contents, licences and citations"
    add_action(actions, "list", text, "turtlebag data list").set_defaults(run=_list)
    text = (
        f"fetch a log or worlds from the folder {MIRROR_VARIABLE} or the network, verified; print the paths"
    )
    fetching = add_action(actions, "fetch", text, EXAMPLE)
    text = "name of a log or worlds, as `turtlebag data list` shows it"
    fetching.option("names", "NAME", text, nargs="+")
    fetching.set_defaults(run=_fetch)


def _list(args: argparse.Namespace) -> int:
    print("\n\n".join(_described(dataset) for dataset in DATASETS.values()))
    return 0


def _described(dataset: Dataset) -> str:
    files = "\n".join(f"  {file.sha256}  {file.url}" for file in dataset.files)
    log = (
        f"; {dataset.scans} scans of {dataset.beams} beams, laser {dataset.laser_x_m:g} m ahead, "
        f"no return {dataset.no_return_m:g} m"
    )
    whose = f"Log: {dataset.author}. Relations: {dataset.relations}" if dataset.relations else dataset.author
    return (
        f"{dataset.name}: {dataset.title}{log if dataset.scans else ''}\n"
        f"  {dataset.license}; {dataset.source}\n  {whose}\n{files}"
    )


def _fetch(args: argparse.Namespace) -> int:
    for name in args.names:
        for path in fetch(name):
            print(path)
    return 0
