"""Pictures of the stages that only use a map: offline localisation and planning."""

from __future__ import annotations

import csv
from contextlib import suppress
from pathlib import Path

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures import maps, series
from turtlebag.reports.figures.album import Album
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.reports.stages import Group, Stage


def given_map(stage: Stage, group: Group) -> OccupancyGrid | None:
    """The very map a stage was given: its files while they have their hashes, else the same map among the
    group's, for a report that was moved; None when it is nowhere to be found.
    """
    given = {name: entry for name, entry in stage.manifest.inputs.items() if name in ("map", "map_image")}
    if "map" not in given:
        return None
    if all(entry.path.is_file() and sha256_tree(entry.path) == entry.sha256 for entry in given.values()):
        with suppress(InputError):
            return load_map(given["map"].path)
    wanted = {digest for entry in given.values() for digest in entry.sha256.values()}
    for other in group.stages:
        for folder, grid in (("", other.map), ("truth/", other.true_map)):
            has = {other.outputs.get(f"{folder}map.yaml"), other.outputs.get(f"{folder}map.pgm")}
            if wanted <= has:
                return grid
    return None


def draw_localise(stage: Stage, group: Group, album: Album) -> None:
    """Where the filter took the robot to be, and how far that was from the truth."""
    estimate = stage.trajectory
    if estimate is None:
        return
    grid = given_map(stage, group)
    record = group.record_of(stage)
    truth = record.truth if record is not None else None
    if stage.metrics.get("status") == "rejected":
        caption = "The robot had no initial pose. The odometry is shown in place of an estimate."
        paths = {"truth": truth, "odometry": estimate}
        album.add("path", "Not localised", caption, maps.trajectories, grid, paths)
        return
    caption = "The path estimated by the particle filter (AMCL)"
    caption += (
        "; the thin line should run along the middle of the wide pale one." if truth is not None else "."
    )
    paths = {"truth": truth, "amcl": estimate}
    album.add("path", "Localised path", caption, maps.trajectories, grid, paths)
    if truth is not None:
        pairs, start = associate(estimate, truth), int(truth.stamps_ns[0])
        caption = "Distance between the estimated and the true position at each scan. It should stay low."
        album.add("error", "Localisation error", caption, series.localisation, pairs, start, [], [])


def draw_plan(stage: Stage, group: Group, album: Album) -> None:
    """The planned path on its map."""
    path = stage.folder / "path.csv"
    if not path.is_file():
        return
    grid, poses = given_map(stage, group), read_path(path)
    compared = planner_paths(stage)
    if compared:
        caption = (
            "Each planner's path from the same start to the same goal. Look for paths that are shorter "
            "but keep less clearance, and for those that take another route."
        )
        album.add("path", "Planners compared", caption, maps.plans, grid, compared)
    elif len(poses):
        plan = Trajectory(np.arange(len(poses), dtype=np.int64), poses)
        album.add("path", "Plan", "The planned path.", maps.trajectories, grid, {"plan": plan})


def read_path(path: Path) -> SE2:
    """Poses (n,) of a `path.csv` with columns x, y, yaw, none where no path was found; InputError when it is
    not one.
    """
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        try:
            if not {"x", "y", "yaw"} <= set(reader.fieldnames or []):
                raise KeyError
            rows = [[float(row[name]) for name in ("x", "y", "yaw")] for row in reader]
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}: not a path (expected columns x,y,yaw)") from None
    return SE2.from_array(np.array(rows).reshape(-1, 3))


def planner_paths(stage: Stage) -> dict[str, SE2]:
    """The way of each planner of a comparison that found one, in the order of the metrics."""
    found = {}
    for entry in stage.metrics.get("planners") or []:
        name = entry.get("planner")
        path = stage.folder / f"path-{name}.csv"
        if path.is_file() and len(poses := read_path(path)):
            found[str(name)] = poses
    return found
