"""Commands killed at any moment and run again: they finish, with the bytes of undisturbed ones."""

import multiprocessing
import os
import pkgutil
import signal
import sys
import time
from contextlib import suppress

import numpy as np
import pytest

import turtlebag
from tests.helpers.fuzz_cases import SESSION
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.pipeline.cli.main import main

KILLS = int(os.environ.get("TURTLEBAG_KILLS", "0"))
ROOM = "--world CHAIN/room.yaml --seed 3"
ON_MAP = f"{ROOM} --map CHAIN/map/map.yaml --initial-pose start"
COMMANDS = {
    "record": f"record {ROOM} --teleop CHAIN/short.yaml",
    "map": "map CHAIN/record --truth CHAIN/record/truth --explain",
    "patrol": f"navigate {ON_MAP} --task patrol --waypoints CHAIN/points.yaml --timeout 30",
    "goal": f"navigate {ON_MAP} --task goal --goal=0.3,0.1,0",
    "avoid": f"navigate {ROOM} --task avoid --duration 5",
    "explore": f"navigate {ROOM} --task explore --duration 5",
    "report": "report CHAIN/record CHAIN/map CHAIN/run",
    "localise": "localise CHAIN/record --map CHAIN/map/map.yaml --initial-pose=0,0,0",
    "plan": "plan --map CHAIN/map/map.yaml --start=0,0,0 --goal=0.5,0,0",
    "compare": "compare CHAIN/map CHAIN/map",
    "convert": "bag convert CHAIN/record",
    "sqlite3": "bag convert CHAIN/record --storage sqlite3",
    "recover": "bag recover CHAIN/record",
    "world.png": "world show turtlebot3_world",
    "sweep": "sweep HERE/campaign.yaml --workers 1",
    "studio": "studio --replay HERE/session.yaml",
    "record3d": "record --world turtlebot3_world --robot waffle_pi_3d --teleop HERE/there.yaml",
    "map3d": "map HERE/record3d --topic /points --truth HERE/record3d/truth",
}
CAMPAIGN = """\
name: small
factors: {seed: {first: 1, last: 3}}
stages:
  record: "record --world CHAIN/room.yaml --teleop CHAIN/short.yaml --seed {seed}"
  map: "map {record} --truth {record}/truth"
results: {ate_m: "map:ate_m.rmse"}
figures: [{x: seed, y: ate_m, title: Error}]
"""
THERE = "{name: there, v: 0.2, w: 0.8, steps: [{through: [[-1.2, -0.55]]}]}"
DONE = (0, 1)
"""Exit codes of complete outputs; a drive of some seconds does not reach everything."""


def commanded(words, errors):
    """What a process does: a command, in a process group of its own, with stderr in a file."""
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    sys.exit(main(words))


@pytest.fixture(scope="module")
def started():
    """Starts a command in a process forked after the imports, so that a kill finds it at work."""
    context, known = multiprocessing.get_context("forkserver"), ["turtlebag.pipeline.stages.record"]
    if KILLS:
        modules = (module.name for module in pkgutil.walk_packages(turtlebag.__path__, "turtlebag."))
        known = [name for name in modules if not name.endswith(("__main__", ".envs"))]
    context.set_forkserver_preload(known)

    def start(words, errors):
        process = context.Process(target=commanded, args=(words, errors))
        process.start()
        return process

    return start


def kill(process):
    """With all that it has started, once it has a group of its own."""
    with suppress(ProcessLookupError):
        alone = os.getpgid(process.pid) != process.pid
        os.kill(process.pid, signal.SIGKILL) if alone else os.killpg(process.pid, signal.SIGKILL)


def hashes(out):
    """sha256 of an output's files but its manifest, by path; a single file is called nothing."""
    found = sha256_tree(out)
    return {"": found[out.name]} if out.is_file() else found


@pytest.fixture(scope="module")
def place(chain, tmp_path_factory):
    """The inputs that the chain lacks."""
    folder = tmp_path_factory.mktemp("kills")
    (folder / "campaign.yaml").write_text(CAMPAIGN.replace("CHAIN", str(chain)))
    (folder / "session.yaml").write_text(SESSION.format(chain=chain))
    (folder / "there.yaml").write_text(THERE)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("stage", COMMANDS if KILLS else ["record"])
def test_a_killed_command_given_again_leaves_what_an_undisturbed_one_does(chain, place, started, stage):
    def ended(process):
        process.join()
        return process.exitcode

    def words(out):
        verb, *rest = COMMANDS[stage].replace("CHAIN", str(chain)).replace("HERE", str(place)).split()
        return [verb, "-q", *rest, "--out", str(out)]

    errors, lasted = place / "stderr", []
    for out in (place / stage, place / "again" / stage):  # the first one compiles
        begun = time.perf_counter()
        assert ended(started(words(out), errors)) in DONE, errors.read_text()
        lasted.append(time.perf_counter() - begun)
    assert hashes(place / "again" / stage) == hashes(place / stage)
    took, rng, killed = lasted[1], np.random.default_rng(0), 0
    while killed < max(1, KILLS):
        folder = place / f"{stage} {killed} {took}"
        folder.mkdir()
        process = started(words(folder / stage), errors)
        time.sleep(rng.uniform(0.0, took))
        kill(process)
        if (code := ended(process)) != -signal.SIGKILL:
            assert code in DONE, errors.read_text()
            took *= 0.95  # the machine is less busy than it was
            continue
        killed += 1
        if not (folder / stage).exists():
            assert ended(started(words(folder / stage), errors)) in DONE, errors.read_text()
        assert hashes(folder / stage) == hashes(place / stage)
        assert {path.name for path in folder.iterdir()} <= {stage, f"{stage}.unfinished"}
