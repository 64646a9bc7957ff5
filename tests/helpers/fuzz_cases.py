"""What is fed to each command: a small chain of good inputs, and one thing of it broken."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import get_args

import yaml

from tests.helpers.fuzz_inputs import broken, tree_broken
from tests.helpers.report_fakes import unrendered
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.studio.journal import load_session
from turtlebag.planners.ompl_planner import PlannerName

SIM = Path(__file__).parents[2] / "sim"
ROOM = """\
name: room
robot: burger
spawn: [0.0, 0.0, 0.0]
bounds: [-1.6, 1.6, -1.6, 1.6]
keepout: [[[1.0, 1.0], [1.2, 1.0], [1.2, 1.2]]]
shapes:
  - {kind: prism, name: east, z: [0.0, 0.5], polygon: [[1.5, -1.5], [1.6, -1.5], [1.6, 1.6], [1.5, 1.6]]}
  - {kind: prism, name: west, z: [0.0, 0.5], polygon: [[-1.6, -1.5], [-1.5, -1.5], [-1.5, 1.6], [-1.6, 1.6]]}
  - {kind: prism, name: north, z: [0.0, 0.5], polygon: [[-1.6, 1.5], [1.6, 1.5], [1.6, 1.6], [-1.6, 1.6]]}
  - {kind: prism, name: south, z: [0.0, 0.5], polygon: [[-1.6, -1.6], [1.6, -1.6], [1.6, -1.5], [-1.6, -1.5]]}
  - {kind: cylinder, name: post, z: [0.0, 0.5], center: [-0.7, 0.6], radius: 0.15}
routes:
  there: [[0.3, 0.1], [0.1, 0.2]]
movers:
  - {name: cart, radius: 0.1, z: [0.0, 0.4], speed: 0.1, path: [[1.1, -1.0], [1.1, 0.0]]}
"""
SHORT = "name: short\nv: 0.2\nw: 0.8\nsteps:\n  - {through: [[0.3, 0.05]]}\n  - {turn_deg: 20}\n"
POINTS = "waypoints:\n  - {x: 0.3, y: 0.0, yaw: 0.0}\n  - {x: 0.3, y: 0.1, quaternion: [0, 0, 0, 1]}\n"
TAKEN = "- {begin: 0.5, end: 1.0, v: 0.1, w: 0.0}\n- {begin: 1.2, end: 1.4, v: 0.0, w: 0.5}\n"
KEPT = "keepout:\n  - [[1.0, 1.0], [1.2, 1.0], [1.2, 1.2]]\n  - [[-1.2, -1.0], [-1.0, -1.0], [-1.0, -1.2]]\n"
SESSION = """\
version: 1
world: {chain}/room.yaml
robot: {chain}/burger.yaml
seed: 3
map: {chain}/map/map.yaml
sim: {{sensors: clean}}
inputs:
- {{at: 0.0, do: record, name: drive}}
- {{at: 0.2, do: pose_estimate, pose: [0.0, 0.0, 0.1]}}
- {{begin: 0.3, end: 0.6, v: 0.1, w: 0.2}}
- {{at: 0.5, do: patrol, waypoints: [{{pose: [0.3, 0.1, 0.0], wait: 1.0}}], laps: 2}}
- {{at: 0.7, do: keepout, outlines: [[[1.0, 1.0], [1.2, 1.0], [1.2, 1.2]]]}}
- {{at: 0.8, do: box, xy: [0.8, -0.8], size: 0.2}}
- {{at: 0.9, do: waypoints_save, name: one, waypoints: [{{pose: [0.3, 0.1, 0.0]}}]}}
- {{at: 1.0, do: map_save, name: again}}
- {{at: 1.2, do: end}}
"""
SDF = """\
<sdf version='1.6'><world name='w'>
<model name='a'><pose>1 0 0.25 0 0 0.2</pose><static>1</static><link name='l'><pose>0 0 0 0 0 0.1</pose>
<collision name='c'><geometry><box><size>0.5 0.5 0.5</size></box></geometry></collision></link></model>
<model name='b'><pose>-1 0 0.25 0 0 0</pose><static>1</static><link name='l'><collision name='c'><geometry>
<cylinder><radius>0.2</radius><length>1</length></cylinder></geometry></collision></link></model>
<state world_name='w'><model name='a'><pose>1 1 0.25 0 0 0</pose></model></state>
</world></sdf>
"""
SWEEP = """\
name: tiny
question: Does it?
factors:
  teleop: [a, b]
  level: {first: 1, last: 3}
  extra: {usual: "", bad: "--set sim.lidar.sigma={level:0.01+0.1*x}"}
stages:
  record: "record --world room --teleop {teleop} --seed {level} {extra}"
  map: "map {record} --truth {record}/truth"
results: {ate_m: {at: "map:ate_m.rmse", unit: cm}, touched: "record:touched"}
compare: teleop
against: a
figures:
  - {x: level, y: ate_m, lines: teleop, log: true, title: Error}
"""


def carmen_log(scans=12):
    """A CARMEN log of a robot that drives 1 m through a corner."""
    lines = ["PARAM robot_front_laser_max 81.9"]
    for k in range(scans):
        x, ranges = 0.1 * k, " ".join(f"{2.0 + 0.01 * ((7 * i + k) % 50):.2f}" for i in range(180))
        pose = f"{x:.3f} 0.000 0.010"
        lines.append(f"ODOM {pose} 0.5 0 0 {k + 0.1:.6f} host {k + 0.1:.6f}")
        lines.append(f"FLASER 180 {ranges} {pose} {pose} {k + 0.2:.6f} host {k + 0.2:.6f}")
    return "\n".join(lines) + "\n"


def make_chain(folder):
    """Good inputs: files, and the outputs record, map, run and report made of them."""
    for name, text in {
        "room.yaml": ROOM, "short.yaml": SHORT, "points.yaml": POINTS, "w.world": SDF, "sweep.yaml": SWEEP,
        "taken.yaml": TAKEN, "kept.yaml": KEPT,
        "drive.log": carmen_log(), "true.relations": "1.2 5.2 0.4 0 0 0 0 0\n3.2 8.2 0.5 0 0 0 0 0\n",
    }.items():  # fmt: skip
        (folder / name).write_text(text)
    shutil.copy(SIM / "robots" / "burger.yaml", folder / "burger.yaml")
    world = ["--world", f"{folder}/room.yaml", "--seed", "3"]
    patrol = ["--task", "patrol", "--waypoints", f"{folder}/points.yaml", "--initial-pose", "start"]
    for words in (
        ["record", *world, "--teleop", f"{folder}/short.yaml", "--out", f"{folder}/record"],
        ["map", f"{folder}/record", "--truth", f"{folder}/record/truth", "--out", f"{folder}/map"],
        ["navigate", *world, *patrol, "--map", f"{folder}/map/map.yaml", "--out", f"{folder}/run"],
        ["report", "--no-animation", *(f"{folder}/{s}" for s in ("record", "map", "run")),
         "--out", f"{folder}/report"],
        ["plan", "--map", f"{folder}/map/map.yaml", "--start=0,0,0", "--goal=0.5,0,0",
         "--out", f"{folder}/plan"],
    ):  # fmt: skip
        with unrendered():
            assert main([words[0], "-q", *words[1:]]) in (0, 1)
    return folder


def _copy(chain, scratch, *names):
    for name in names:
        source = chain / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, scratch / name)


def _file(rng, chain, scratch, name):
    """A broken copy of a file of the chain."""
    shutil.copy(chain / name, scratch / Path(name).name)
    broken(rng, scratch / Path(name).name)
    return scratch / Path(name).name


def _config(rng, chain, scratch, stage):
    """`--config FILE` or `--set KEY=VALUE` from the stage's own saved settings."""
    good = yaml.load((chain / stage / "config.yaml").read_text(), yaml.CSafeLoader)
    if stage == "record":
        good = {"sim": good["sim"]}
    if rng.random() < 0.8:
        (scratch / "config.yaml").write_text(yaml.dump(good, Dumper=yaml.CSafeDumper))
        if rng.random() < 0.15:
            broken(rng, scratch / "config.yaml")
        else:
            text = yaml.dump(tree_broken(rng, good), Dumper=yaml.CSafeDumper)
            (scratch / "config.yaml").write_text(text)
        return ["--config", scratch / "config.yaml"]
    way, node = [], good
    while isinstance(node, dict) and node:
        way.append(rng.choice(list(node)))
        node = node[way[-1]]
    value = rng.choice(
        ["", "nan", "-1", "0", "1e300", "[", "{}", "[1,2]", "null", "x", "1e-300", "=", "\x00", "!!set"]
    )
    return ["--set", f"{'.'.join(way)}={value}"]


def _record(chain, **changed):
    given = {"world": chain / "room.yaml", "teleop": chain / "short.yaml", **changed}
    return ["record", "-q", "--seed", "3", *(w for key, value in given.items() for w in (f"--{key}", value))]


def _navigate(chain, task, *more, **changed):
    given = {"world": chain / "room.yaml", **changed}
    if task in ("goal", "patrol"):
        given = {"map": chain / "map" / "map.yaml", "initial-pose": "start", "timeout": "2", **given}
    words = ["navigate", "-q", "--task", task]
    return [*words, *(w for key, value in given.items() for w in (f"--{key}", value)), *more]


def _map_file(rng, chain, scratch):
    _copy(chain, scratch, "map")
    broken(rng, scratch / "map" / rng.choice(["map.yaml", "map.pgm"]))
    return scratch / "map" / "map.yaml"


def _bag(rng, chain, scratch):
    _copy(chain, scratch, "record")
    name = rng.choice(["bag_0.mcap"] * 5 + ["metadata.yaml"])
    broken(rng, scratch / "record" / "bag" / name)
    return (
        scratch / "record"
        if name == "metadata.yaml" or rng.random() < 0.5
        else scratch / "record/bag/bag_0.mcap"
    )


def _map_bag(rng, chain, scratch):
    return ["map", "-q", _bag(rng, chain, scratch)]


def _bag_command(rng, chain, scratch):
    verb = rng.choice(["info", "doctor", "recover", "convert", "convert"])
    more = ["--storage", "sqlite3"] if verb == "convert" and rng.random() < 0.5 else []
    return ["bag", verb, _bag(rng, chain, scratch), *more]


def _replay(rng, chain, scratch):
    return _record(chain, teleop=_bag(rng, chain, scratch))


def _localise(rng, chain, scratch):
    start = rng.choice(["0,0,0", "0,0,0", "global", "1e300,0,0", "5,5,1e9"])
    if rng.random() < 0.5:
        bag, grid = chain / "record", _map_file(rng, chain, scratch)
    else:
        bag, grid = _bag(rng, chain, scratch), chain / "map" / "map.yaml"
    return ["localise", "-q", bag, "--map", grid, f"--initial-pose={start}"]


def _carmen(rng, chain, scratch):
    log = _file(rng, chain, scratch, "drive.log")
    return rng.choice([["map", "-q", log], ["bag", "info", log], ["bag", "convert", log]])


def _relations(rng, chain, scratch):
    return ["map", "-q", chain / "drive.log", "--relations", _file(rng, chain, scratch, "true.relations")]


def _truth(rng, chain, scratch):
    shutil.copytree(chain / "record" / "truth", scratch / "truth")
    broken(rng, scratch / "truth" / rng.choice(["trajectory.tum", "trajectory.tum", "map.yaml", "map.pgm"]))
    return ["map", "-q", chain / "record", "--truth", scratch / "truth"]


def _bare_map(rng, scratch):
    """A map of one kind of cell, or of none."""
    value, (width, height) = rng.choice([0, 205, 254]), rng.choice([(64, 64), (64, 64), (1, 1), (0, 0)])
    (scratch / "bare.pgm").write_bytes(
        b"P5 %d %d 255\n" % (width, height) + bytes([value]) * (width * height)
    )
    (scratch / "bare.yaml").write_text(
        "image: bare.pgm\nresolution: 0.05\norigin: [-1.6, -1.6, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return scratch / "bare.yaml"


def _bare(rng, chain, scratch):
    """Any verb that takes a map, on a bare one."""
    grid, start = _bare_map(rng, scratch), rng.choice(["0,0,0", "90,0,0", "global"])
    if rng.random() < 0.3:
        return ["localise", "-q", chain / "record", "--map", grid, f"--initial-pose={start}"]
    more = {"map": grid, "initial-pose": rng.choice([start, "start"])}
    if rng.random() < 0.5:
        return _navigate(chain, "patrol", waypoints=chain / "points.yaml", **more)
    return _navigate(chain, "goal", "--goal=0.4,0,0", **more)


def _goal(rng, chain, scratch):
    if rng.random() < 0.7:
        return _navigate(chain, "goal", "--goal=0.4,0,0", map=_map_file(rng, chain, scratch))
    values = rng.choices(POSES, k=3)
    option = rng.choice(["--goal", "--start", "--initial-pose"])
    return _navigate(chain, "goal", "--goal=0.4,0,0", f"{option}={','.join(values)}")


POSES = ["0", "0.4", "-0.4", "0.1", "-0.0", "1e300", "1e9", "-3", "inf", "nan", "", "x", "1e-320"]


def _plan(rng, chain, scratch):
    """A broken map, robot, setting or pose, or any planner on good ones."""
    given = {"map": chain / "map" / "map.yaml", "robot": chain / "burger.yaml", "seed": "1"}
    what, more = rng.randrange(6), []
    given |= {"start": "0,0,0", "goal": "0.5,-0.3,1"}
    if what < 2:
        given["map"] = _map_file(rng, chain, scratch)
    elif what == 2:
        given["robot"] = _file(rng, chain, scratch, "burger.yaml")
    elif what == 3:
        given[rng.choice(["start", "goal"])] = ",".join(rng.choices(POSES, k=rng.choice([3, 3, 3, 2, 4])))
    elif what == 4:
        more = _config(rng, chain, scratch, "plan")
    else:
        given["seed"] = rng.choice(["0", "-1", "x", "99999999999999999999", "1e3"])
        more = ["--planner", rng.choice([*get_args(PlannerName), "Dijkstra", ""])]
    return ["plan", "-q", *(f"--{key}={value}" for key, value in given.items()), *more]


def _clutter(rng, chain, scratch):
    seed = rng.choice(["3", "", "-1", "x", "1e3", "9" * 30])
    pairs = [
        f"{rng.choice(['boxes', 'movers', 'cars', ''])}={rng.choice(['0', '1', '2', '-1', '99', 'x', ''])}"
    ]
    return _record(
        chain, world=f"{chain}/room.yaml+clutter:{','.join([seed, *pairs][: rng.choice([1, 2, 2])])}"
    )


def _session(rng, chain, scratch):
    """Options of `map` that take other inputs or poses."""
    if rng.random() < 0.4:
        _copy(chain, scratch, "map")
        broken(rng, scratch / "map" / "graph.npz")
        return ["map", "-q", chain / "record", "--continue", scratch / "map"]
    if rng.random() < 0.5:
        return ["map", "-q", chain / "record", "--also", _bag(rng, chain, scratch)]
    return ["map", "-q", chain / "record", f"--laser={','.join(rng.choices(POSES, k=3))}"]


def _truth_parts(rng, chain, scratch):
    _copy(chain, scratch, "record")
    files = ["bag/bag_0.mcap", "truth/trajectory.tum", "truth/map.yaml"]
    if rng.random() < 0.8:
        broken(rng, scratch / "record" / rng.choice(files))
    part = rng.choice(["front_end", "loops.match", "back_end"])
    name = rng.choice(["TrueFrontEnd", "TrueLoops", "TrueLocaliser", "Luck"])
    truth = rng.choice([[], [f"--truth={scratch / 'record'}"]])
    return ["map", "-q", scratch / "record", *truth, "--set", f"{part}=turtlebag.testing:{name}"]


def _stage_folder(rng, chain, scratch):
    """report, compare and verify on stage folders of which one file is broken or gone."""
    verb, stage = rng.choice(["report", "compare", "verify"]), rng.choice(["record", "map", "run"])
    _copy(chain, scratch, stage)
    if verb == "verify":
        _copy(chain, scratch, "report")
        text = (scratch / "report" / "metrics.json").read_text()
        (scratch / "report" / "metrics.json").write_text(text.replace(str(chain), str(scratch)))
        text = (scratch / "report" / "manifest.json").read_text()
        (scratch / "report" / "manifest.json").write_text(
            text.replace(str(chain / stage), str(scratch / stage))
        )
    folder = scratch / "report" if verb == "verify" and rng.random() < 0.7 else scratch / stage
    wanted = (".json", ".yaml", ".tum", ".csv", ".g2o", ".pgm", ".mcap")
    files = sorted(path for path in folder.rglob("*") if path.suffix in wanted)
    victim = rng.choice(files)
    if rng.random() < 0.1:
        victim.unlink()
    else:
        broken(rng, victim)
    if verb == "verify":
        return ["verify", scratch / "report"]
    if verb == "compare":
        return ["compare", *rng.sample([scratch / stage, chain / stage], 2)]
    return ["report", "-q", "--no-animation", scratch / stage]


def _world(rng, chain, scratch):
    world = _file(rng, chain, scratch, rng.choice(["room.yaml", "room.yaml", "w.world"]))
    return ["world", "show", world] if rng.random() < 0.25 else _record(chain, world=world)


def _driven_again(rng, chain, scratch):
    """A broken session; one that would go on for long stays as it is."""
    text = SESSION.format(chain=chain)
    path = scratch / "session.yaml"
    path.write_text(text)
    broken(rng, path)
    with suppress(InputError):
        if load_session(path).until_ns > 10e9:
            path.write_text(text)
    return ["studio", "-q", "--replay", path]


CASES = {
    "record settings": lambda *a: [*_record(a[1]), *_config(*a, "record")],
    "map settings": lambda *a: ["map", "-q", a[1] / "record", *_config(*a, "map")],
    "navigate settings": lambda *a: _navigate(a[1], "goal", "--goal=0.3,0.1,0", *_config(*a, "run")),
    "mapless settings": lambda *a: _navigate(a[1], "avoid", "--duration=1", *_config(*a, "run")),
    "world": _world,
    "robot": lambda *a: _record(a[1], robot=_file(*a, "burger.yaml")),
    "teleop": lambda *a: _record(a[1], teleop=_file(*a, "short.yaml")),
    "waypoints": lambda *a: _navigate(a[1], "patrol", waypoints=_file(*a, "points.yaml")),
    "goal and map": _goal,
    "bare map": _bare,
    "bag to map": _map_bag,
    "bag commands": _bag_command,
    "bag to drive again": _replay,
    "localise": _localise,
    "log": _carmen,
    "relations": _relations,
    "truth": _truth,
    "stage folders": _stage_folder,
    "plan": _plan,
    "clutter": _clutter,
    "sessions and laser": _session,
    "truth parts": _truth_parts,
    "teleop override": lambda *a: _navigate(
        a[1], "avoid", f"--teleop-override={_file(*a, 'taken.yaml')}", "--duration=2"
    ),
    "keepout": lambda *a: _navigate(a[1], "goal", "--goal=0.3,0.1,0", keepout=_file(*a, "kept.yaml")),
    "session to drive again": _driven_again,
    "sweep": lambda *a: ["sweep", "-q", _file(*a, "sweep.yaml"), "--scheduler", "threads"],
}
