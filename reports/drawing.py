"""Which pictures each stage gets, and what they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.bags.reader import read_particles, read_poses
from datasets.errors import InputError
from datasets.grid import OccupancyGrid
from datasets.recordings import load_recording
from datasets.runlog import RunLog
from datasets.se2 import SE2
from datasets.types import Recording, Trajectory
from reports.draw_localise import given_map
from reports.figures import animation, maps, series
from reports.figures.album import Album, Picture
from reports.figures.graph import pose_graph, shown_edges
from reports.figures.style import styled
from reports.g2o import read_g2o, read_loops
from reports.metrics.navigation import collision_episodes
from reports.metrics.trajectory import associate
from reports.stages import Group, Stage

SNAPSHOTS = 6


def draw_record(stage: Stage, group: Group, album: Album, prefix: str) -> list[Picture]:
    """The drive on the true map."""
    if stage.truth is None:
        return []
    odometry = read_poses(stage.folder / "bag", "/odom")
    with styled():
        figure = maps.trajectories(stage.true_map, {"truth": stage.truth, "odometry": odometry})
        caption = "True path and what the wheels believe, on the true map. The arrow is the start."
        return [album.add(f"{prefix}-drive", "The drive", caption, figure)]


def draw_map(stage: Stage, group: Group, album: Album, prefix: str) -> list[Picture]:
    """The map and its errors where truth is known; the map with its path where not."""
    grid, slam = stage.map, stage.trajectory
    record = group.first("record")
    truth = record.truth if record is not None else None
    true_map = record.true_map if record is not None else None
    recording = source_recording(stage, record)
    odometry = odometry_of(recording)
    pictures = []
    with styled():
        if grid is not None and true_map is not None:
            caption = "Every occupied cell of the map, coloured by how far it is from a true surface (grey)."
            pictures.append(
                album.add(f"{prefix}-error", "Map over truth", caption, maps.map_over_truth(grid, true_map))
            )
        if slam is not None and truth is not None:
            paths = {"truth": truth, "odometry": odometry, "slam": slam}
            caption = "Odometry drifts; SLAM should cover the truth."
            pictures.append(
                album.add(f"{prefix}-paths", "Trajectories", caption, maps.trajectories(grid, paths))
            )
            pictures.append(_error_picture(album, prefix, slam, odometry, truth))
        elif grid is not None:
            caption = "The map, with the path of the robot."
            pictures.append(album.add(f"{prefix}-map", "Map", caption, maps.plain_map(grid, {"slam": slam})))
            if odometry is not None and slam is not None:
                paths = {"odometry": odometry, "slam": slam}
                caption = "The path by odometry alone and after SLAM."
                pictures.append(
                    album.add(f"{prefix}-paths", "Trajectories", caption, maps.trajectories(grid, paths))
                )
        if stage.has("graph.g2o"):
            pictures.append(_graph_picture(stage, grid, album, prefix))
    return pictures + _mapping_animation(stage, recording, odometry, album, prefix)


def _mapping_animation(
    stage: Stage, recording: Recording | None, odometry: Trajectory | None, album: Album, prefix: str
) -> list[Picture]:
    slam, grid = stage.trajectory, stage.map
    if recording is None or slam is None or grid is None or not album.animate or len(slam) != len(recording):
        return []
    data = animation.gif(animation.mapping(recording, slam, odometry, grid))
    caption = "Scans where SLAM puts them; its path blue, the odometry's orange."
    return [album.add_animation(f"{prefix}-animation", "How the map grew", caption, data)]


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
    what = "loops drawn" if record is not None else "between distant keys drawn"
    caption = f"{len(graph.T_map_keys)} keys, {len(graph.i)} edges; the {len(pairs)} {what}"
    if len(pairs):
        middle, worst = 100.0 * float(np.median(residual_m)), 100.0 * float(residual_m.max())
        caption += f", median residual {middle:.2f} cm, largest {worst:.1f} cm"
    return album.add(f"{prefix}-graph", "Pose graph", caption + ".", pose_graph(graph, grid, record))


def _error_picture(
    album: Album, prefix: str, slam: Trajectory, odometry: Trajectory | None, truth: Trajectory
) -> Picture:
    at_scans = None
    if odometry is not None:
        at_scans = associate(Trajectory(truth.stamps_ns, odometry.at(truth.stamps_ns)), truth)
    figure = series.error_over_time(associate(slam, truth), at_scans, truth)
    caption = (
        "Errors of SLAM and odometry above the true speed and yaw rate: what the robot did when they grew. "
        "Linear up to 1, logarithmic beyond."
    )
    return album.add(f"{prefix}-time", "Error over time", caption, figure)


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
    with styled():
        estimate = stage.trajectory if stage.metrics.get("localisation_error_m") else None
        figure = maps.patrol(world, truth, estimate, goals, log.T_world_base.xy[first])
        caption = "True and estimated path" if estimate is not None else "True path"
        caption += "; goals in their order, coloured and shaped by how they ended." if goals else "."
        pictures = [album.add(f"{prefix}-path", "The run", caption, figure)]
        ends = goal_ends(log)
        if estimate is not None:
            figure = series.localisation(associate(estimate, truth), int(log.t_ns[0]), episodes, ends)
            caption = "Estimate against truth; dotted lines: a goal ended, bands: contact."
            pictures.append(album.add(f"{prefix}-localisation", "Localisation error", caption, figure))
        commands = np.stack([log.v, log.w], axis=1)
        figure = series.clearance(log.t_ns, log.clearance_m, commands, episodes, ends)
        caption = "Footprint to the nearest surface, and what the controller commanded."
        pictures.append(album.add(f"{prefix}-clearance", "Clearance", caption, figure))
        figure = maps.clearance_on_map(world, truth, log.clearance_m)
        caption = "Where it was tight."
        pictures.append(album.add(f"{prefix}-tight", "Clearance along the path", caption, figure))
        pictures += _particle_pictures(stage, world, truth, album, prefix)
    if not album.animate:
        return pictures
    data = animation.gif(
        animation.run(
            world,
            truth,
            log.goal_index,
            goals,
            read_again(stage.folder),
            estimate if estimate is not None else stage.truth,
        )
    )
    caption = "The true path, the goal pursued (orange), and the scan where the robot believes it is."
    return [*pictures, album.add_animation(f"{prefix}-animation", "The run, moving", caption, data)]


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
    shown = [((clouds[k][0] - start) * 1e-9, clouds[k][1]) for k in np.unique(pick)]
    caption = "The particle cloud, more often at the start; the black arrow is the true pose."
    return [album.add(f"{prefix}-particles", "Particles", caption, maps.particles(world, shown, truth))]


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
