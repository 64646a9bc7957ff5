"""The documentation does what it says: commands run, our readers read the examples, links lead somewhere."""

import importlib.util
import inspect
import os
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from tests.helpers.help_text import actions, options
from tests.helpers.page_commands import BLOCK, commands, run_page
from turtlebag.datasets.maps import MapYaml
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import load_model
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.cli.main import VERBS, joined
from turtlebag.pipeline.navigation.teleop_override import load_script
from turtlebag.pipeline.slam import mapper
from turtlebag.pipeline.slam.graph.edits import load_edits
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.studio.journal import load_session
from turtlebag.planners.tasks.waypoints import load_waypoints
from turtlebag.reports.g2o import read_g2o, read_loops
from turtlebag.reports.stages import read_path
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

ROOT = Path(__file__).parents[1]
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [*DOCS, ROOT / "README.md"]
LAB = ROOT / "docs/lab"
"""Notes of earlier versions: their commands and files are those of their time."""
PRESENT = [page for page in PAGES if LAB not in page.parents]


def name_of(page):
    return page.relative_to(ROOT).with_suffix("").as_posix()


# Those of the tutorial run in test_end_to_end, which looks at what they leave.
WITH_COMMANDS = [
    pytest.param(page, id=name_of(page))
    for page in PRESENT
    if commands(page.read_text()) and page.stem != "tutorial"
]


TWO_LIDARS = "record --world turtlebot3_world --robot waffle_pi_two_lidars --teleop"
QUICKER = {f"{TWO_LIDARS} tour": f"{TWO_LIDARS} fast"}
"""The same in half the time."""


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_commands_of_a_page_run_as_written(page, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    run_page(page, tmp_path, monkeypatch, QUICKER)


def mentioned():
    """Every command that a page names without running it, in code: (page, command)."""
    for page in PRESENT:
        text = page.read_text()
        others = [block for kind, block in BLOCK.findall(text) if kind in ("", "bash", "console", "text")]
        lines = [line.strip() for block in others for line in block.splitlines()]
        prose = BLOCK.sub("", text)
        lines += [line.strip() for line in re.findall(r"^    (.+)$", prose, re.M)]
        lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose)]
        for line in lines:
            if re.match(r"(\w+=\S+ )?(turtlebag|make|python -m|bash|\./)\b", line):
                yield pytest.param(line.partition(" #")[0].strip(), id=f"{name_of(page)}: {line[:60]}")


MENTIONED = list(mentioned())
TARGETS = set(re.findall(r"^([a-z][a-z-]*(?: [a-z-]+)*):", (ROOT / "Makefile").read_text(), re.M))
TARGETS = {name for names in TARGETS for name in names.split()} | {"study-%"}


@pytest.mark.parametrize("line", MENTIONED)
def test_a_command_that_is_only_mentioned_is_one_we_have(line):
    words = [word for word in shlex.split(line) if not re.fullmatch(r"[A-Z_]+=\S*", word)]
    if words[0] == "turtlebag":
        check_verb(words[1:])
    elif words[0].startswith("turtlebag."):
        assert importlib.util.find_spec(words[0]) is not None
    elif words[0] == "make":
        for target in (word for word in words[1:] if word != "-B"):
            assert target in TARGETS, f"make has no target {target}"
    else:
        assert words[:2] == ["python", "-m"], f"{line}: neither turtlebag nor make"
        assert importlib.util.find_spec(words[2].removesuffix(".")) is not None
        source = Path(importlib.util.find_spec(words[2]).origin).read_text()
        assert all(word in source for word in words[3:] if word.startswith("--"))


def check_verb(words):
    """The verb, its actions and its options exist; what stands for a value is not looked at."""
    if not words or words[0].startswith("-"):
        return
    for verb in words[0].split("|"):
        assert verb in VERBS, f"no verb {verb}"
        known = set(options(verb))
        if actions(verb) and len(words) > 1 and not words[1].startswith("-"):
            for action in words[1].split("|"):
                assert action in actions(verb), f"{verb} has no {action}"
                known |= set(options(verb, action))
        for word in joined(words[1:]):
            if word.startswith("-") and not re.match(r"-[\d.]", word):
                assert word.partition("=")[0] in known, f"turtlebag {verb} knows no {word}"


def test_commands_are_looked_for_where_they_stand():
    assert len(MENTIONED) > 25
    with pytest.raises(AssertionError, match="no verb mpa"):
        check_verb(["mpa", "BAG"])
    with pytest.raises(AssertionError, match="knows no --ot"):
        check_verb(["map", "BAG", "--ot", "DIR"])


TRANSLATED = ("README", "docs/tutorial")


@pytest.mark.parametrize("name", TRANSLATED)
def test_a_translation_has_the_commands_of_its_page(name):
    """To the letter, but for comments: what runs those of the page runs its own."""
    page, translation = (ROOT / f"{place}.md" for place in (name, f"docs/zh/{Path(name).name}"))
    blocks, own = (code_of(one.read_text()) for one in (page, translation))
    assert own
    if name == "README":  # the start of it
        blocks = [one for one in blocks if one in own]
    assert own == blocks


def code_of(text):
    """The blocks of a page, without comments, and the commands in its lines."""
    blocks = [(kind, re.sub(r" +# .*", "", block)) for kind, block in BLOCK.findall(text)]
    inline = [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", BLOCK.sub("", text))]
    return [*blocks, *(("", code) for code in inline if code.startswith(("turtlebag ", "--", "map --")))]


READERS = {
    "map.yaml": lambda path: load_model(MapYaml, path),
    "trajectory.tum": load_tum,
    "graph.g2o": read_g2o,
    "graph.json": read_loops,
    "runlog.csv": RunLog.load,
    "path.csv": read_path,
    "map-config.yaml": lambda path: load_config(SlamConfig, path, []),
    "waypoints.yaml": load_waypoints,
    "teleop_override.yaml": load_script,
    "session.yaml": load_session,
    "edits.yaml": load_edits,
    "intel.relations": load_relations,
    "robot.yaml": lambda path: load_robot(str(path)),
    "campaign.yaml": lambda path: load_model(Campaign, path),
    "drive.clf": load_recording,
}
EXAMPLES = [
    pytest.param(kind.split()[1], block, id=f"{name_of(page)}: {kind.split()[1]}")
    for page in DOCS
    for kind, block in BLOCK.findall(page.read_text())
    if len(kind.split()) == 2
]


@pytest.mark.parametrize(("file", "text"), EXAMPLES)
def test_the_example_of_a_file_is_read_by_what_reads_such_files(file, text, tmp_path):
    (tmp_path / file).write_text(text)
    assert READERS[file](tmp_path / file) is not None


def test_the_robot_of_the_example_drives(tmp_path):
    (text,) = (param.values[1] for param in EXAMPLES if param.values[0] == "robot.yaml")
    (tmp_path / "robot.yaml").write_text(text)
    robot = load_robot(str(tmp_path / "robot.yaml"))
    with Simulator(load_world("empty"), robot, SimConfig(), 1) as simulator:
        simulator.reset()
        for _ in range(60):
            simulator.step(Twist(0.2, 0.0))
        assert 0.2 < float(simulator.truth.T_world_base.x) < 0.42


def test_each_format_has_its_page_and_each_page_an_example_or_a_table():
    assert {param.values[0] for param in EXAMPLES} == set(READERS)
    for page in sorted((ROOT / "docs/formats").glob("*.md")):
        assert f"(formats/{page.name})" in (ROOT / "docs/files.md").read_text(), page.name
        assert "|---|" in page.read_text() or "```" in page.read_text()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_and_pictures_lead_to_files_that_are_there(page):
    text = page.read_text()
    targets = re.findall(r"\]\(([^)#]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    for target in targets:
        if "://" not in target:
            assert (page.parent / target).exists(), target


def headings(page):
    """The anchors of a page's headings, as GitHub and the site name them."""
    plain = re.sub(r"[`\[]|\]\([^)]*\)", "", BLOCK.sub("", page.read_text()))
    names = re.findall(r"^#+ (.+)$", plain, re.M)
    return {re.sub(r"[^\w\- ]", "", name.strip().lower()).replace(" ", "-") for name in names}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_anchors_are_headings_of_their_page(page):
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)#([^)]+)\)", page.read_text()):
        assert anchor in headings(page.parent / target if target else page), f"{target}#{anchor}"


def test_every_page_can_be_reached_from_the_index():
    seen, todo = set(), [ROOT / "docs/README.md"]
    while todo:
        page = todo.pop().resolve()
        if page in seen:
            continue
        seen.add(page)
        links = re.findall(r"\]\(([^)#:]+\.md)", page.read_text())
        todo += [page.parent / link for link in links]
    assert {page.resolve() for page in DOCS} <= seen
    assert "docs/README.md" in (ROOT / "README.md").read_text()


def cells(page):
    """The cells of every row of the tables of a page."""
    rows = re.findall(r"^\| (.+) \|$", page.read_text(), re.M)
    return [[cell.strip() for cell in row.split(" | ")] for row in rows if not row.startswith("-")]


def test_the_numbers_of_the_readme_are_those_of_the_results():
    readme = cells(ROOT / "README.md")
    here = readme[readme.index(["measured", "runs", "median", "worst"]) + 1 :]
    results = [row[:4] for row in cells(ROOT / "docs/results.md")]
    assert here
    assert [row for row in here if row not in results] == []


def test_the_listing_of_the_mapper_is_its_code():
    (listing,) = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/how-it-maps.md").read_text(), re.M | re.S)
    steps = (mapper.track_recording, mapper.solve_graph, mapper.draw_map)
    assert listing == "\n\n".join(map(inspect.getsource, steps)), "copy them to docs/how-it-maps.md"


def test_the_pictures_are_small_and_shown_and_the_animations_of_the_readme_move():
    shown = {
        (page.parent / name).resolve()
        for page in PAGES
        for name in re.findall(r'src="([^"]+)"', page.read_text())
    }
    assert shown == set((ROOT / "docs/images").iterdir())
    for image in shown:
        if image.suffix == ".gif":
            assert image.read_bytes().count(b"\x21\xf9\x04") > 10
            assert image.stat().st_size < 500_000
        else:
            assert image.suffix in (".png", ".svg")
            assert image.stat().st_size < 150_000


def test_no_page_holds_a_path_of_a_machine():
    here = os.sep.join(["", "root"]), os.sep.join(["", "home", ""]), os.sep.join(["", "tmp", ""])
    for page in PAGES:
        assert not any(place in page.read_text() for place in here), name_of(page)


def test_one_version_in_the_package_the_citation_and_the_changelog():
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    newest = re.search(r"^## (\S+) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest is not None
    assert newest.groups() == (package["version"], str(citation["date-released"]))
    assert citation["version"] == package["version"]
    assert [author["name"] for author in citation["authors"]] == [a["name"] for a in package["authors"]]
