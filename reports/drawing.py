"""Which pictures each stage gets, and what they say."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from turtlebag.datasets.bags.reader import read_particles
from turtlebag.datasets.errors import if_there
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.ply import read_ply
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.reports.figures import animation, maps, runs, series
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.particles import particles
from turtlebag.reports.figures.robots import EFFECTS_TOLD, draw_plots, effects
from turtlebag.reports.g2o import read_g2o, read_loops
from turtlebag.reports.metrics.navigation import collision_episodes
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.reports.numbers import shown
from turtlebag.reports.stages import Group, Stage, read_json, read_path

SNAPSHOTS = 6


def draw_record(stage: Stage, group: Group, album: Album) -> None:
    """The drive on the true map."""
    if stage.truth is None:
        return
    paths = {"truth": stage.truth, "odometry": stage.odometry}
    caption = (
        "The robot's true path, and its path by wheel odometry. The farther apart they are, the more "
        "mapping has to correct."
    )
    album.add("drive", "The drive", caption, maps.trajectories, stage.true_map, paths)


def draw_map(stage: Stage, group: Group, album: Album) -> None:
    """The map and its errors where truth is known; the map with its path where not."""
    grid, slam = stage.map, stage.trajectory
    record = group.record_of(stage)
    truth, true_map = (None, None) if record is None else (record.truth, record.true_map)
    if grid is not None and true_map is not None:
        caption = (
            "Every wall cell of the map, coloured by its distance from the nearest true surface (grey). Blue "
            "is on the surface, grey-brown one cell away; orange is a wall that does not exist."
        )
        album.add("error", "Map over truth", caption, maps.map_over_truth, grid, true_map)
    if grid is not None and (slam is None or truth is None):
        caption = (
            "The map and the robot's path. The truth is not known here; look for walls that appear twice."
        )
        album.add("map", "Map", caption, maps.plain_map, grid, {"slam": slam})
    recording = source_recording(stage, record)
    odometry = None if recording is None else recording.path
    paths = {"truth": truth, "odometry": odometry, "slam": slam}
    if slam is not None and truth is not None:
        caption = (
            "SLAM's path should run along the middle of the wide pale band, which is the truth. "
            "Odometry alone drifts away from it."
        )
        album.add("paths", "Trajectories", caption, maps.trajectories, grid, paths)
        _add_errors(album, slam, odometry, truth)
    elif slam is not None and grid is not None and odometry is not None:
        caption = "The path by odometry alone and the path by SLAM."
        album.add("paths", "Trajectories", caption, maps.trajectories, grid, paths)
    if stage.has("map.ply") and len(points := read_ply(stage.folder / "map.ply")):
        caption = (
            "The 3D map from above, showing the highest point at each place. Walls should be thin lines and "
            "the floor one colour. A floor that changes colour is bent; a wall that appears twice was not "
            "recognised."
        )
        album.add("cloud", "Point cloud", caption, maps.cloud_from_above, points)
    if stage.has("graph.g2o") and stage.has("graph.json"):
        _add_graph(stage, grid, album)
    _add_mapping_animation(stage, recording, odometry, album)


def _add_mapping_animation(
    stage: Stage, recording: Recording | None, odometry: Trajectory | None, album: Album
) -> None:
    slam, grid = stage.trajectory, stage.map
    if recording is None or slam is None or grid is None or not album.animate or len(slam) != len(recording):
        return

    caption = (
        "The scans as SLAM places them, with its path in blue and the odometry's in purple. Walls seen again "
        "on a later visit should fall on those seen before."
    )
    told = recording, slam, odometry, grid
    album.add_animation("animation", "Animation of the map", caption, animation.write_mapping, *told)


def _add_graph(stage: Stage, grid: OccupancyGrid | None, album: Album) -> None:
    graph = read_g2o(stage.folder / "graph.g2o")
    record = read_loops(stage.folder / "graph.json")
    pairs, residual_m = record.kept(len(graph.T_map_keys))
    caption = (
        "The grey line joins the key scans in order, coloured lines visits to the same place: blue where "
        "they agree with the map, orange where they conflict with it. "
        f"{len(graph.T_map_keys)} key scans, {graph.edges} edges; the {len(pairs)} loops are drawn"
    )
    if len(pairs):
        middle, worst = shown(float(np.median(residual_m)), "cm"), shown(float(residual_m.max()), "cm")
        caption += f". Residual of a loop: median {middle}, largest {worst}"
    album.add("graph", "Pose graph", caption + ".", maps.pose_graph, graph, grid, record)


def _add_errors(album: Album, slam: Trajectory, odometry: Trajectory | None, truth: Trajectory) -> None:
    def draw() -> Figure:
        at_scans = None
        if odometry is not None:
            at_scans = associate(odometry.sampled(truth.stamps_ns), truth)
        return series.error_over_time(associate(slam, truth), at_scans, truth)

    caption = (
        "Top: the errors of SLAM and of the odometry. Bottom: the robot's speeds. SLAM's error should "
        f"fall again after every turn; the odometry's does not. {series.AXIS_TOLD}"
    )
    album.add("time", "Error over time", caption, draw)


def draw_identify(stage: Stage, group: Group, album: Album) -> None:
    """The data behind the estimates."""
    if stage.has("plots.json"):
        draw_plots(read_json(stage.folder / "plots.json"), album)


def draw_twin(stage: Stage, group: Group, album: Album) -> None:
    """What differs, and the map that is the twin's world."""
    album.add(
        "effects", "Real beside simulated", EFFECTS_TOLD, effects, stage.metrics.get("quantities") or {}
    )
    if stage.has("map/map.yaml"):
        grid = load_map(stage.folder / "map" / "map.yaml")
        album.add("map", "World of the twin", "The map of the real drive.", maps.plain_map, grid, {})


def source_recording(stage: Stage, record: Stage | None) -> Recording | None:
    """What a map was made from: its record, or the log itself while that is still there."""
    if record is not None:
        return if_there(lambda: record.recording)
    for folder in stage.input_paths().values():
        recording = if_there(load_recording, folder)
        if recording is not None:
            return recording
    return None


def draw_run(stage: Stage, group: Group, album: Album) -> None:
    """What a run drove, how well it knew where it was, and how near it came to things."""
    log = stage.runlog
    if log is None or len(log) == 0:
        return
    given = group.given_map(stage) if stage.localised else None
    world = given if given is not None else stage.true_map
    truth = Trajectory(log.t_ns, log.T_world_base)
    goals = stage.metrics.get("goals") or []
    contact = log.contact_visible | log.contact_low
    episodes = collision_episodes(log.t_ns, contact)
    touched_at = np.searchsorted(log.t_ns, [first for first, _ in episodes])
    estimate = stage.trajectory if stage.localised else None
    decisions = decisions_of(log) if not goals and stage.fact("task") == "avoid" else None
    caption = _run_caption(estimate is not None, bool(goals), decisions)
    drawn = (world, truth, estimate, goals, log.T_world_base.xy[touched_at], decisions)
    album.add("path", "The run", caption, runs.run, *drawn)
    ends = goal_ends(log)
    if estimate is not None:
        caption = (
            "Distance between the estimated and the true position. It should stay low. Dotted lines "
            f"mark the end of a goal, orange bands contact. {series.AXIS_TOLD}"
        )
        errors = (associate(estimate, truth), int(log.t_ns[0]), episodes, ends)
        album.add("localisation", "Localisation error", caption, series.localisation, *errors)
    caption = (
        "Top: the distance from the footprint to the nearest surface (0 is contact). Bottom: the "
        "controller's commands, smooth in open space and uneven where it had to avoid something."
    )
    room = (log.t_ns, log.clearance_m, np.stack([log.v, log.w], axis=1), episodes, ends)
    album.add("clearance", "Clearance", caption, series.clearance, *room)
    caption = "The true path, coloured by clearance: orange where it was tight, ▼ where it was smallest."
    on_map = runs.clearance_on_map
    album.add("tight", "Clearance along the path", caption, on_map, world, truth, log.clearance_m)
    if stage.map is not None and stage.true_map is not None:
        caption = (
            "The map built during the run: every wall cell, coloured by its distance from the nearest "
            "true surface (grey)."
        )
        album.add("map", "The map it built", caption, maps.map_over_truth, stage.map, stage.true_map)
    _add_particles(stage, world, truth, album)
    if album.animate:
        _add_run_animation(stage, world, truth, estimate, log, album)


def decisions_of(log: RunLog) -> runs.Decisions:
    """Where the driver's word changed."""
    changed = [k for k in range(len(log)) if k == 0 or log.state[k] != log.state[k - 1]]
    return runs.Decisions(log.T_world_base[np.array(changed)], [log.state[k] for k in changed])


def _run_caption(localised: bool, goals: bool, decisions: runs.Decisions | None) -> str:
    caption = "The true path"
    if localised:
        caption = "The true path (wide, pale) and the robot's estimate of it (thin)"
    if goals:
        return f"{caption}. Goals are numbered in order; colour and shape show the true outcome."
    if decisions is None:
        return f"{caption}."
    turns = sum(word in runs.DECISIONS for word in decisions.words)
    return f"{caption}. An arrow marks each of the {turns} places where it decided to turn or back off."


def _add_run_animation(
    stage: Stage,
    world: OccupancyGrid | None,
    truth: Trajectory,
    estimate: Trajectory | None,
    log: RunLog,
    album: Album,
) -> None:
    goals = stage.metrics.get("goals") or []
    scans_at = estimate if estimate is not None else stage.truth
    caption = (
        "The true path (pale), and the scan (green) drawn from the estimated pose. The scan should lie "
        "on the walls."
    )
    caption += " A goal is blue while pursued, green once reached, orange if missed." if goals else ""
    recording = if_there(lambda: stage.recording)
    told = world, truth, log.goal_index, goals, recording, scans_at
    album.add_animation("animation", "Animation of the run", caption, animation.write_run, *told)


def _add_particles(stage: Stage, world: OccupancyGrid | None, truth: Trajectory, album: Album) -> None:
    clouds = if_there(lambda: list(read_particles(stage.folder / "bag")))
    if not clouds:
        return
    start = int(truth.stamps_ns[0])
    chosen = np.unique((np.linspace(0.0, 1.0, SNAPSHOTS) ** 2 * (len(clouds) - 1)).astype(int))
    snapshots = [((clouds[k][0] - start) * 1e-9, clouds[k][1]) for k in chosen]
    caption = (
        "Each green stroke is a particle, a hypothesis of the robot's pose, or several that coincide; the "
        "arrow with a dot is the truth. Each panel is zoomed to the particles, so note its scale bar: they "
        "should converge and stay around the arrow. More panels are from the start of the run."
    )
    album.add("particles", "Particles", caption, particles, world, snapshots, truth)


def goal_ends(log: RunLog) -> list[float]:
    """Seconds since the start at which the goal changed."""
    changed = np.flatnonzero(np.diff(log.goal_index) != 0) + 1
    ended = [k for k in changed if log.goal_index[k - 1] >= 0]
    return [float(log.t_ns[k] - log.t_ns[0]) * 1e-9 for k in ended]


def draw_localise(stage: Stage, group: Group, album: Album) -> None:
    """Where the filter took the robot to be, and how far that was from the truth."""
    estimate = stage.trajectory
    if estimate is None:
        return
    grid = group.given_map(stage)
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
        caption = (
            "Distance between the estimated and the true position at each scan. It should stay low. "
            f"{series.AXIS_TOLD}"
        )
        album.add("error", "Localisation error", caption, series.localisation, pairs, start, [], [])


def draw_plan(stage: Stage, group: Group, album: Album) -> None:
    """The planned path on its map."""
    grid = group.given_map(stage)
    if compared := planner_paths(stage):
        caption = (
            "Each planner's path from the same start to the same goal. Look for paths that are shorter "
            "but keep less clearance, and for those that take another route."
        )
        album.add("path", "Planners compared", caption, maps.plans, grid, compared)
    elif stage.plan is not None:
        paths = {"plan": stage.plan}
        album.add("path", "Plan", "The planned path.", maps.trajectories, grid, paths)


def planner_paths(stage: Stage) -> dict[str, SE2]:
    """The way of each planner of a comparison that found one, in the order of the metrics."""
    found = {}
    for entry in stage.metrics.get("planners") or []:
        name = entry.get("planner")
        path = stage.folder / f"path-{name}.csv"
        if path.is_file() and len(poses := read_path(path)):
            found[str(name)] = poses
    return found
