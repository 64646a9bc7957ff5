"""The pictures of the studio in README and docs, taken with Chromium.

python .ci/site/studio_pictures.py FOLDER
"""

import asyncio
import os
import shutil
import sys
import tempfile
from asyncio.subprocess import DEVNULL
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs/examples"))

from studio_client import Client

from turtlebag.datasets.maps import save_map
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.studio.access import LOOPBACK, Access, listen, new_token
from turtlebag.pipeline.studio.inputs import parse_input
from turtlebag.pipeline.studio.server import serve
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import BagSetup, StudioSetup

WORLD, WIDE, HIGH, COLOURS = "turtlebot3_world", 1280, 720, 64
LOOPS = SlamConfig.model_validate({"loops": {"held_m": 0.0}})
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size={WIDE},{HIGH}")
LOADED_MS = 8000
"""Time of the page after which it is drawn."""


class Scene:
    """A session that is brought to where its picture is taken."""

    def __init__(self, setup, folder):
        folder.mkdir()
        self.session = Session(setup, folder, lambda line: None)
        self.last = {}
        """An input for when time stands still."""

    def do(self, do, **fields):
        """An input."""
        self.session.apply(parse_input({"do": do, **fields}))

    def wait(self, most_s, enough=lambda view: False):
        """Let time pass, until there is enough to see."""
        for tick in range(round(30 * most_s)):
            self.session.tick()
            if tick % 30 == 0 and enough(self.session.view()):
                return

    def pose(self, ahead_m=0.0, turn=0.0):
        """An estimate, so far from the true pose."""
        x, y, yaw = self.session.view().T_world_base.xyt.tolist()
        return {"do": "pose_estimate", "pose": [x + ahead_m, y + ahead_m, yaw + turn]}


def mapping(folder):
    """While exploring; the bag of it is played in the last picture."""
    scene = Scene(StudioSetup(WORLD, seed=1), folder / "mapping")
    scene.do("record", name="bag_1")
    scene.do("map_start")
    scene.do("explore")
    scene.wait(100.0, lambda view: not view.task)
    scene.do("goal", pose=[-1.8, -0.5, 0.0])
    scene.wait(60.0, lambda view: not view.task)
    return scene


def wrong_pose(folder, true_map):
    """Before a pose is set beside where the robot is: the filter would correct it before one looks."""
    scene = Scene(StudioSetup(WORLD, seed=1, map_path=true_map), folder / "pose")
    scene.wait(1.0)
    scene.last = scene.pose(0.22, 0.35)
    return scene


def patrol(folder, true_map):
    """Five of the tutorial's eight waypoints are reached."""
    scene = Scene(StudioSetup(WORLD, seed=1, map_path=true_map), folder / "patrol")
    scene.do("waypoints_load")
    scene.do(**scene.pose())
    stops = [{"pose": list(stop[:3])} for stop in scene.session.view().waypoints]
    scene.do("patrol", waypoints=stops)
    scene.wait(400.0, lambda view: sum(goal.status == "reached" for goal in view.goals) == 5)
    scene.wait(4.0)
    return scene


def bag(folder):
    """A loop of the bag that was recorded while mapping."""
    scene = Scene(BagSetup(folder / "mapping/bags/bag_1", LOOPS), folder / "bag")
    scene.do("map_build")
    view = scene.session.view()
    loops = view.graph.edges[view.graph.edges[:, 2] == 1]
    if len(loops):
        i, j = loops[len(loops) // 2, :2]
        scene.do("loop_show", scan=int(view.bag.keys[i]), place=int(view.bag.keys[j]))
    scene.do("seek", t=0.5 * view.bag.duration_s)
    return scene


def walls(folder):
    """A wall is drawn between two pillars of that map, and two others are erased."""
    scene = Scene(BagSetup(folder / "mapping/bags/bag_1", LOOPS), folder / "walls")
    scene.do("map_build")
    scene.do("wall_draw", points=[[-0.9, -1.1], [-0.2, -1.1]])
    for x in (0.0, 1.1):
        scene.do("wall_erase", points=[[x, 0.0]], width=0.5)
    scene.do("seek", t=0.0)
    return scene


def find_browser():
    """Path of a Chromium, from TURTLEBAG_CHROMIUM or the search path."""
    known = [os.environ.get("TURTLEBAG_CHROMIUM"), *map(shutil.which, BROWSERS)]
    return next(filter(None, known), None) or sys.exit("no Chromium here: `make browser` installs one")


async def taken(scene, file):
    """The page of a session, while time stands still."""
    sockets, interrupted = listen(LOOPBACK, 0), []
    access = Access(new_token(), LOOPBACK, sockets[0].getsockname()[1])
    serving = asyncio.create_task(
        serve(scene.session, access, sockets, interrupted=interrupted, ready=lambda: None)
    )
    await asyncio.sleep(0)
    client = await Client.open(access.url)
    await client.asked("pause")
    if scene.last:
        await client.asked(**scene.last)
    client.close()
    profile = f"--user-data-dir={file.parent / 'profile'}"
    wanted = f"--virtual-time-budget={LOADED_MS}", f"--screenshot={file}", access.url
    browser = await asyncio.create_subprocess_exec(find_browser(), *FLAGS, profile, *wanted, stderr=DEVNULL)
    await browser.wait()
    interrupted.append(2)
    await serving


def picture(scene, shot, file):
    """The picture of a session, with few colours: it is mostly flat."""
    asyncio.run(taken(scene, shot))
    scene.session.close()
    Image.open(shot).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(file, optimize=True)
    print(f"{file}: {file.stat().st_size // 1024} KiB")


def main(out):
    """All of them, into a folder."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        setup = StudioSetup(WORLD)
        save_map(setup.arena.rasterize(setup.spec.lidar_height), folder)
        true_map = folder / "map.yaml"
        for file, made in (
            ("mapping", lambda: mapping(folder)),
            ("pose", lambda: wrong_pose(folder, true_map)),
            ("patrol", lambda: patrol(folder, true_map)),
            ("bag", lambda: bag(folder)),
            ("walls", lambda: walls(folder)),
        ):
            picture(made(), folder / "shot.png", out / f"studio_{file}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
