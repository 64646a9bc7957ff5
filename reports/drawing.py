"""Which pictures each stage gets, and what they say."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from datasets.bags.reader import read_particles, read_poses
from datasets.errors import InputError
from datasets.grid import OccupancyGrid
from datasets.ply import read_ply
from datasets.recordings import load_recording
from datasets.runlog import RunLog
from datasets.se2 import SE2
from datasets.types import Recording, Trajectory
from reports.draw_localise import given_map
from reports.figures import animation, maps, series
from reports.figures.album import Album, Picture
from reports.figures.cloud import cloud_from_above
from reports.figures.graph import pose_graph, shown_edges
from reports.g2o import read_g2o, read_loops
from reports.metrics.navigation import collision_episodes
from reports.metrics.trajectory import associate
from reports.numbers import shown
from reports.stages import Group, Stage

SNAPSHOTS = 6


def draw_record(stage: Stage, group: Group, album: Album, prefix: str) -> list[Picture]:
    """The drive on the true map."""
    if stage.truth is None:
        return []
    paths = {"truth": stage.truth, "odometry": read_poses(stage.folder / "bag", "/odom")}
    caption = (
        "Where the robot really went, and where its wheels say it went: the further apart, the more mapping "
        "has to put right. The arrow is the start."
    )
    draw = partial(maps.trajectories, stage.true_map, paths)
    return [album.add(f"{prefix}-drive", "The drive", caption, draw)]


def draw_map(stage: Stage, group: Group, album: Album, prefix: str) -> list[Picture]:
    """The map and its errors where truth is known; the map with its path where not."""
    grid, slam = stage.map, stage.trajectory
    record = group.record_of(stage)
    truth = record.truth if record is not None else None
    true_map = record.true_map if record is not None else None
    recording = source_recording(stage, record)
    odometry = odometry_of(recording)
    pictures = []
    if grid is not None and true_map is not None:
        caption = (
            "Every wall cell of the map, coloured by how far it is from a true surface (grey). Blue lies on "
            "it, grey-brown one cell beside; look for orange: a wall that is not there."
        )
        draw = partial(maps.map_over_truth, grid, true_map)
        pictures.append(album.add(f"{prefix}-error", "Map over truth", caption, draw))
    if slam is not None and truth is not None:
        caption = "SLAM should hide the truth beneath it; the odometry alone wanders off."
        draw = partial(maps.trajectories, grid, {"truth": truth, "odometry": odometry, "slam": slam})
        pictures.append(album.add(f"{prefix}-paths", "Trajectories", caption, draw))
        pictures.append(_error_picture(album, prefix, slam, odometry, truth))
    elif grid is not None:
        caption = "The map, with the path of the robot. Look for walls drawn twice: there is no truth to ask."
        draw = partial(maps.plain_map, grid, {"slam": slam})
        pictures.append(album.add(f"{prefix}-map", "Map", caption, draw))
        if odometry is not None and slam is not None:
            caption = "The path by odometry alone and after SLAM."
            draw = partial(maps.trajectories, grid, {"odometry": odometry, "slam": slam})
            pictures.append(album.add(f"{prefix}-paths", "Trajectories", caption, draw))
    if stage.has("map.ply"):
        pictures += _cloud_picture(stage, album, prefix)
    if stage.has("graph.g2o"):
        pictures.append(_graph_picture(stage, grid, album, prefix))
    return pictures + _mapping_animation(stage, recording, odometry, album, prefix)


def _cloud_picture(stage: Stage, album: Album, prefix: str) -> list[Picture]:
    points = read_ply(stage.folder / "map.ply")
    if len(points) == 0:
        return []
    caption = (
        "The 3D map from above, the highest point in each place. Walls should be thin lines, the floor one "
        "colour: a floor that changes colour bends, a wall drawn twice was not recognised."
    )
    draw = partial(cloud_from_above, points)
    return [album.add(f"{prefix}-cloud", "Point cloud", caption, draw)]


def _mapping_animation(
    stage: Stage, recording: Recording | None, odometry: Trajectory | None, album: Album, prefix: str
) -> list[Picture]:
    slam, grid = stage.trajectory, stage.map
    if recording is None or slam is None or grid is None or not album.animate or len(slam) != len(recording):
        return []

    def draw() -> bytes:
        return animation.gif(animation.mapping(recording, slam, odometry, grid))

    caption = (
        "Scans where SLAM puts them; its path blue, the odometry's orange. Walls drawn again on a later "
        "visit should fall on those drawn before."
    )
    return [album.add_animation(f"{prefix}-animation", "How the map grew", caption, draw)]


def read_again(folder: Path) -> Recording | None:
    """A stage's own recording, None when it holds no scans."""
    try:
        return load_recording(folder)
    except InputError:
        return None


def _graph_picture(stage: Stage, grid: OccupancyGrid | None, album: Album, prefix: str) -> Picture:
    graph = read_g2o(stage.folder / "graph.g2o")
    record = read_loops(stage.folder / "graph.json") if stage.has("graph.json") else None
    pairs, residual_m = shown_edges(graph, record)
    what = "loops" if record is not None else "edges between distant keys"
    caption = (
        "Dots are key scans; lines between them are places recognised again, blue where they agree with the "
        f"map, orange where they pull against it. {len(graph.T_map_keys)} key scans, {len(graph.i)} edges, "
        f"the {len(pairs)} {what} drawn"
    )
    if len(pairs):
        middle, worst = shown(float(np.median(residual_m)), "cm"), shown(float(residual_m.max()), "cm")
        caption += f"; what is left of a loop's error: median {middle}, largest {worst}"
    draw = partial(pose_graph, graph, grid, record)
    return album.add(f"{prefix}-graph", "Pose graph", caption + ".", draw)


def _error_picture(
    album: Album, prefix: str, slam: Trajectory, odometry: Trajectory | None, truth: Trajectory
) -> Picture:
    def draw() -> Figure:
        at_scans = None
        if odometry is not None:
            at_scans = associate(Trajectory(truth.stamps_ns, odometry.at(truth.stamps_ns)), truth)
        return series.error_over_time(associate(slam, truth), at_scans, truth)

    caption = (
        "Above: how far off SLAM and the odometry were. Below: what the robot did then. SLAM's error should "
        "come back down after every turn; the odometry's stays. Linear up to 1, logarithmic beyond."
    )
    return album.add(f"{prefix}-time", "Error over time", caption, draw)


def source_recording(stage: Stage, record: Stage | None) -> Recording | None:
    """What a map was made from: its record, or the log itself while that is still there."""
    for folder in [record.folder] if record is not None else stage.input_paths().values():
        recording = read_again(folder)
        if recording is not None:
            return recording
    return None


def odometry_of(recording: Recording | None) -> Trajectory | None:
    """Odometry of a recording, at its full rate where there is one."""
    if recording is None:
        return None
    if recording.odometry is not None:
        return recording.odometry
    poses = recording.T_odom_base
    return None if poses is None else Trajectory(recording.stamps_ns, poses)


def draw_run(stage: Stage, group: Group, album: Album, prefix: str) -> list[Picture]:
    """What a run drove, how well it knew where it was, and how near it came to things."""
    log = stage.runlog
    if log is None or len(log) == 0:
        return []
    world = _background(stage, group)
    truth = Trajectory(log.t_ns, log.T_world_base)
    goals = stage.metrics.get("goals") or []
    contact = log.contact_visible | log.contact_low
    episodes = collision_episodes(log.t_ns, contact)
    first = contact & ~np.concatenate([[False], contact[:-1]])
    estimate = stage.trajectory if stage.metrics.get("localisation_error_m") else None
    caption = (
        "True path, and above it where the robot believed to be" if estimate is not None else "True path"
    )
    caption += "; goals numbered in their order, coloured and shaped by how they ended." if goals else "."
    draw = partial(maps.patrol, world, truth, estimate, goals, log.T_world_base.xy[first])
    pictures = [album.add(f"{prefix}-path", "The run", caption, draw)]
    ends = goal_ends(log)
    if estimate is not None:
        caption = (
            "How far the robot's belief was from the truth: it should stay low and come back down. Dotted "
            "lines: a goal ended; bands: contact."
        )
        pairs = associate(estimate, truth)
        draw = partial(series.localisation, pairs, int(log.t_ns[0]), episodes, ends)
        pictures.append(album.add(f"{prefix}-localisation", "Localisation error", caption, draw))
    caption = (
        "Room between the footprint and the nearest surface (0 is touch), above what the controller "
        "commanded then: smooth while it is sure, ragged where it had to dodge."
    )
    commands = np.stack([log.v, log.w], axis=1)
    draw = partial(series.clearance, log.t_ns, log.clearance_m, commands, episodes, ends)
    pictures.append(album.add(f"{prefix}-clearance", "Clearance", caption, draw))
    caption = "The true path coloured by that room: orange is where it was tight, \u25bc where tightest."
    draw = partial(maps.clearance_on_map, world, truth, log.clearance_m)
    pictures.append(album.add(f"{prefix}-tight", "Clearance along the path", caption, draw))
    if stage.map is not None and stage.true_map is not None:
        caption = (
            "What it mapped on its way, every wall cell coloured by how far it is from a true surface (grey)."
        )
        draw = partial(maps.map_over_truth, stage.map, stage.true_map)
        pictures.append(album.add(f"{prefix}-map", "The map it made", caption, draw))
    pictures += _particle_pictures(stage, world, truth, album, prefix)
    if album.animate:
        pictures.append(_run_animation(stage, world, truth, estimate, log, album, prefix))
    return pictures


def _run_animation(
    stage: Stage,
    world: OccupancyGrid | None,
    truth: Trajectory,
    estimate: Trajectory | None,
    log: RunLog,
    album: Album,
    prefix: str,
) -> Picture:
    goals = stage.metrics.get("goals") or []

    def draw() -> bytes:
        scans_at = estimate if estimate is not None else stage.truth
        recording = read_again(stage.folder)
        return animation.gif(animation.run(world, truth, log.goal_index, goals, recording, scans_at))

    caption = "The true path, the scan where the robot believes it is: it should lie on the walls"
    caption += "; goals orange while pursued, green once reached." if goals else "."
    return album.add_animation(f"{prefix}-animation", "The run, moving", caption, draw)


def _background(stage: Stage, group: Group) -> OccupancyGrid | None:
    """The map a run that localised was given, else the true world."""
    grid = given_map(stage, group) if stage.metrics.get("localisation_error_m") else None
    return grid if grid is not None else stage.true_map


def _particle_pictures(
    stage: Stage, world: OccupancyGrid | None, truth: Trajectory, album: Album, prefix: str
) -> list[Picture]:
    clouds = particle_clouds(stage.folder / "bag")
    if not clouds:
        return []
    start = int(truth.stamps_ns[0])
    pick = np.unique(np.linspace(0.0, 1.0, SNAPSHOTS) ** 2 * (len(clouds) - 1)).astype(int)
    snapshots = [((clouds[k][0] - start) * 1e-9, clouds[k][1]) for k in np.unique(pick)]
    caption = (
        "Each stroke is one guess of where the robot is; the cloud should close in on the true pose, the "
        "black arrow. More often at the start."
    )
    draw = partial(maps.particles, world, snapshots, truth)
    return [album.add(f"{prefix}-particles", "Particles", caption, draw)]


def particle_clouds(bag: Path) -> list[tuple[int, SE2]]:
    """(stamp, poses) of /particlecloud; empty when the bag has none."""
    try:
        return list(read_particles(bag))
    except InputError:
        return []


def goal_ends(log: RunLog) -> list[float]:
    """Seconds since the start at which the goal changed."""
    changed = np.flatnonzero(np.diff(log.goal_index) != 0) + 1
    ended = [k for k in changed if log.goal_index[k - 1] >= 0]
    return [float(log.t_ns[k] - log.t_ns[0]) * 1e-9 for k in ended]
