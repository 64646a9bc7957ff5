"""`turtlebag studio` as a command, with the real simulator: the tutorial over the socket alone."""

import io
import re
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml
from tornado.httpclient import AsyncHTTPClient

from tests.helpers.full_disks import files_below
from tests.studio.fakes import connect, run
from tests.studio.walk import differences, files
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.studio.journal import load_session

pytestmark = pytest.mark.slow
OUTSIDE = "127.0.0.2"
"""An address of this machine that no browser is told of."""
ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/\?token=[\w-]{43}\n")


def started(folder, *options):
    """A studio's process, and the address it prints."""
    process = subprocess.Popen(
        [sys.executable, "-m", "turtlebag", "studio", "--no-browser", *options],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    line = process.stdout.readline()
    assert ADDRESS.fullmatch(line), process.communicate()
    return process, line.strip()


async def drive(client, seconds, v, w):
    """As a key held down does: asked for again five times a second."""
    for _ in range(round(5 * seconds)):
        client.ask("drive", v=v, w=w)
        await client.read_for(0.2)
    client.ask("release")


async def tutorial(url):
    client = await connect(url)
    await client.until(lambda p: p.head)
    client.ask("record", name="bag_1")
    client.ask("map_start")
    await client.until(lambda p: p.head["mapping"] and p.head["recording"] == "bag_1")
    client.ask("speed", factor=4)
    await drive(client, 0.8, 0.2, 0.4)
    await drive(client, 0.8, 0.2, -0.4)
    await client.until(lambda p: "map" in p.grids and (p.grids["map"] == 0).sum() > 1000, 120.0)
    client.ask("map_save", name="map_world")
    client.ask("map_load", name="map_world")
    await client.until(lambda p: p.head["map"] == "map_world", 120.0)
    x, y, yaw = client.picture.head["true_pose"]
    client.ask("pose_estimate", pose=[x + 0.1, y - 0.1, yaw + 0.1])
    await client.until(lambda p: p.head["localised"] and len(p.arrays["particles"]) > 100)
    client.ask("speed", factor=0)
    client.ask("goal", pose=[x - 0.5, y, 0.0])
    await client.until(lambda p: [g["status"] for g in p.head["goals"]] == ["reached"], 120.0)
    client.ask("pause")
    await client.until(lambda p: p.head["paused"])
    client.ask("box", xy=[0.5, 0.5], size=0.2)
    client.ask("record_stop")
    client.ask("step")
    client.ask("resume")
    await client.until(lambda p: len(p.arrays["boxes"]) == 1 and p.head["recording"] is None)
    client.ask("waypoints_load")
    await client.until(lambda p: len(p.waypoints) == 8)
    client.ask("goal", pose=[99.0, 0.0, 0.0])
    client.ask("avoid")
    await client.until(lambda p: p.head["task"] == "avoid" and len(p.errors) == 1)
    await client.read_for(0.3)
    return client.picture


def test_the_tutorial_over_the_socket_is_driven_again_to_the_same_bytes(tmp_path):
    process, url = started(tmp_path, "--seed", "2")
    try:
        picture = run(tutorial(url), 300.0)
    finally:
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Traceback" not in told
    out = tmp_path / "data/studio/turtlebot3_world-burger-2"
    assert not out.with_name(f"{out.name}.partial").exists()
    assert {"bags/bag_1/metadata.yaml", "maps/map_world.pgm", "session.yaml", "metrics.json"} <= set(
        map(str, files(out))
    )
    entries = yaml.safe_load((out / "session.yaml").read_text())["inputs"]
    done = [entry["do"] for entry in entries if "do" in entry]
    assert done == [
        "record", "map_start", "map_save", "map_load", "pose_estimate", "goal", "box", "record_stop",
        "waypoints_load", "avoid", "end",
    ]  # fmt: skip
    (error,) = picture.errors
    assert error.startswith("goal 99,0,0: is off the map")
    again = tmp_path / "again"
    assert main(["studio", "--replay", str(out / "session.yaml"), "--out", str(again)]) == 0
    assert differences(out, again) == []


def test_a_termination_ends_the_session_and_tells_its_viewers(tmp_path):
    process, url = started(tmp_path, "--out", "mine")

    async def watch():
        client = await connect(url)
        client.ask("record", name="open")
        await client.until(lambda p: p.head.get("recording") == "open")
        process.terminate()
        with pytest.raises(EOFError, match="the studio was stopped"):
            await client.until(lambda p: False)

    run(watch())
    _, told = process.communicate(timeout=60)
    assert process.returncode == 143, told
    assert (tmp_path / "mine/manifest.json").exists()
    assert (tmp_path / "mine/bags/open/metadata.yaml").exists()


class Printed(io.StringIO):
    """Standard output, and someone who opens the page that is printed there and ends the session."""

    def __init__(self):
        super().__init__()
        self.ended = []
        self._threads = ThreadPoolExecutor()

    def write(self, text):
        if text.startswith("http"):
            self.ended.append(self._threads.submit(run, self._end(text.strip())))
        return super().write(text)

    async def _end(self, url):
        client = await connect(url)
        client.ask("end")
        with pytest.raises(EOFError, match="the session has ended"):
            await client.until(lambda p: False)
        return url


@pytest.fixture
def opened(monkeypatch):
    """What a browser was opened with, where there is no screen."""
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    return opened


def test_the_end_of_the_session_is_the_end_of_the_command(tmp_path, monkeypatch, capsys, opened):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(sys, "stdout", printed := Printed())
    assert main(["studio", "--world", "empty", "--out", str(tmp_path / "mine"), "-q"]) == 0
    (ended,) = printed.ended
    assert printed.getvalue() == f"{ended.result()}\n"
    assert capsys.readouterr().err == ""
    assert opened == [ended.result()]
    assert (tmp_path / "mine/manifest.json").exists()


def test_without_a_screen_no_browser_is_opened_and_the_first_free_folder_is_taken(
    tmp_path, monkeypatch, capsys, opened
):
    """On an address of the whole machine, which is said to be for everybody."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data/studio/maze_1-waffle_pi-4").mkdir(parents=True)
    (tmp_path / "data/studio/maze_1-waffle_pi-4-2.partial").mkdir()
    words = ("--world", "maze:1", "--robot", "waffle_pi", "--seed", "4", "--host", "0.0.0.0")
    monkeypatch.setattr(sys, "stdout", Printed())
    assert main(["studio", *words]) == 0
    assert opened == []
    assert (tmp_path / "data/studio/maze_1-waffle_pi-4-3/manifest.json").exists()
    assert "--host 0.0.0.0: anyone who can reach this machine" in capsys.readouterr().err


class FromOutside(Printed):
    """A browser outside of a container: what it asks of the printed address arrives at another one."""

    async def _end(self, url):
        port = re.search(r":(\d+)/", url)[1]
        there = re.sub(r"//[\d.]+:", f"//{OUTSIDE}:", url)
        self.codes = {}
        for host in (url.split("/")[2], f"evil.example:{port}", f"127.0.0.1:{int(port) + 1}"):
            for address in (there, there.partition("?")[0]):
                page = await AsyncHTTPClient().fetch(address, headers={"Host": host}, raise_error=False)
                self.codes[host.replace(port, "PORT"), "token" in address] = page.code
        client = await connect(there, Host=url.split("/")[2])
        client.ask("end")
        with pytest.raises(EOFError, match="the session has ended"):
            await client.until(lambda p: False)
        return url


@pytest.mark.parametrize(("host", "shown"), [("0.0.0.0", "127.0.0.1"), (OUTSIDE, OUTSIDE)])
def test_a_container_shows_the_studio_to_who_has_the_token_and_names_the_host(
    host, shown, tmp_path, monkeypatch, capsys, opened
):
    """`docker run -p 127.0.0.1:8080:8080 turtlebag ... --host 0.0.0.0 --port 8080`, without Docker."""
    with socket.create_server((host, 0)) as free:
        port = free.getsockname()[1]
    monkeypatch.setattr(sys, "stdout", printed := FromOutside())
    words = ["--world", "empty", "--host", host, "--port", str(port), "--out", str(tmp_path / "mine"), "-q"]
    assert main(["studio", *words]) == 0
    (ended,) = printed.ended
    assert re.fullmatch(rf"http://{shown}:{port}/\?token=[\w-]{{43}}", ended.result())
    ours = printed.codes.pop((f"{shown}:PORT", True))
    assert ours == 200
    assert set(printed.codes.values()) == {403}
    assert len(printed.codes) == 5


def test_a_session_that_cannot_go_on_is_kept_beside_the_first_free_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    usual = "data/studio/empty-burger-1"
    for name in (usual, f"{usual}-2.partial", f"{usual}-3.unfinished"):
        (tmp_path / name).mkdir(parents=True)
    with files_below(3_000):
        assert main(["studio", "--world", "empty", "--no-browser"]) == 1
    aside = f"{usual}-3.unfinished-2"
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"turtlebag: {usual}-3: File too large; what was recorded is kept in {aside} "
        f"(`turtlebag studio --replay {aside}/session.yaml --out DIR` makes a finished output of it)"
    )
    assert load_session(tmp_path / aside / "session.yaml").until_ns > 2e9


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--edits edits.yaml", "--edits: edits the map of a bag; give --bag, too"),
        (
            "--bag edits.yaml --seed 2",
            "--seed: cannot be used with --bag, where nothing is simulated; remove it",
        ),
        (
            "--replay edits.yaml --edits edits.yaml",
            "--edits: cannot be used with --replay, which takes it from",
        ),
    ],
)
def test_options_that_do_not_go_together_are_one_line(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("edits.yaml").write_text("version: 1\n")
    assert main(["studio", *words.split()]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"turtlebag: {said}")
    assert [path.name for path in tmp_path.iterdir()] == ["edits.yaml"]
