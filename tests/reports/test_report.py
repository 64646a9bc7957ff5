"""The report of recordings, maps and runs, made from small stand-ins of their outputs."""

import html
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.helpers.help_text import options
from tests.helpers.report_fakes import fake_record, unrendered
from turtlebag.datasets.outputs import Output, sha256_tree
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.recipe import command_of, recipe, rename
from turtlebag.pipeline.stages.report import make_report
from turtlebag.reports.glossary import WORDS, explained
from turtlebag.reports.grouping import group_stages
from turtlebag.reports.kinds import verdict
from turtlebag.reports.metric_specs import SECTIONS
from turtlebag.reports.numbers import sections_of, shown
from turtlebag.reports.stages import Group, Input, Manifest, Stage, changed_files, load_stage
from turtlebag.reports.verdicts import collision_count


@pytest.fixture(scope="module")
def stages(drawn):
    return [drawn / name for name in ("record", "map", "run")]


@pytest.fixture(scope="module")
def page(drawn):
    return drawn / "report/index.html"


class Tags(HTMLParser):
    VOID = ("meta", "link", "br", "img", "input", "source")

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.references, self.images, self.text = [], [], [], 0, []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        if tag not in self.VOID:
            self.open.append(tag)
        self.images += tag in ("svg", "img")
        if "id" in found:
            self.ids.append(found["id"])
        self.references += [found[name] for name in ("src", "href", "xlink:href") if found.get(name)]

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def tags(page):
    parser = Tags()
    parser.feed(page.read_text())
    assert parser.open == []
    return parser


@pytest.mark.slow
def test_the_page_is_self_contained(tags):
    assert tags.images == 15
    for reference in tags.references:
        assert reference.startswith(("#", "data:")), reference


@pytest.mark.slow
def test_every_fragment_points_to_something_and_ids_are_unique(tags):
    assert len(tags.ids) == len(set(tags.ids))
    targets = {reference[1:] for reference in tags.references if reference.startswith("#")}
    assert targets <= set(tags.ids)


@pytest.mark.slow
def test_the_page_says_what_happened(tags):
    text = " ".join(tags.text)
    assert "0 of 1 task succeeded" in text
    assert "2 of 3 goals reached (1 timeout), 1 collision." in text
    assert "% of the wall cells lie within one cell of a true surface" in text
    assert "timeout" in text


@pytest.mark.slow
def test_numbers_of_the_stages_are_in_metrics_json(page):
    metrics = json.loads((page.parent / "metrics.json").read_text())["room"]
    assert 0.003 < metrics["map"]["ate_m"]["rmse"] < 0.012
    assert metrics["patrol"]["goals_reached"] == 2
    assert metrics["record"]["scans"] == 150
    assert 0.05 < metrics["record"]["odometry_ate_m"]["rmse"] < 0.3


@pytest.mark.slow
def test_a_value_stands_with_the_unit_it_is_stored_in_or_none(page):
    text = page.read_text()
    assert re.search(r"<code>0\.0\d+</code> m at <code>ate_m\.rmse", text)
    assert "<code>150</code> at <code>scans" in text
    assert "<code>False</code> at <code>true_success" in text


@pytest.mark.slow
def test_the_recipe_names_outputs_by_stage_and_holds_no_path_of_this_machine(page, stages):
    text = page.read_text()
    assert str(stages[0].parent) not in text
    recipe = re.search(r'<pre class="recipe">(.*?)</pre>', text, re.DOTALL).group(1)
    assert recipe.splitlines()[:2] == [
        "turtlebag record --world room --robot burger --out room/record",
        "turtlebag map room/record --out room/map",
    ]
    assert "--map room/map/map.yaml --task patrol --seed 1 --out room/patrol" in recipe


@pytest.mark.slow
def test_the_same_stages_give_the_same_bytes_wherever_they_are(page, stages, tmp_path):
    for folder in stages:
        shutil.copytree(folder, tmp_path / folder.name)
        manifest = tmp_path / folder.name / "manifest.json"
        manifest.write_text(manifest.read_text().replace(str(folder.parent), str(tmp_path)))
    again = make_report([tmp_path / folder.name for folder in stages], Output(tmp_path / "report"))
    assert sha256_tree(again.parent) == sha256_tree(page.parent)


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [[1], [2]])
def test_any_subset_of_stages_makes_a_page(stages, chosen, tmp_path):
    with unrendered():
        page = make_report([stages[k] for k in chosen], Output(tmp_path / "out"), animate=False)
    assert "<svg" in page.read_text()


def test_each_map_is_held_against_its_own_recording():
    def stage(kind, inputs, outputs):
        named = {name: {"path": name, "sha256": files} for name, files in inputs.items()}
        manifest = {"stage": kind, "world": "room", "inputs": named, "outputs": outputs}
        return Stage(Path(kind), kind, kind, Manifest.model_validate(manifest))

    def record(n):
        files = {"bag/bag_0.mcap": f"bag {n}", "truth/map.pgm": "room", "truth/trajectory.tum": f"truth {n}"}
        return stage("record", {}, files)

    first, second = record(1), record(2)
    of_second = stage("map", {"source": {"bag_0.mcap": "bag 2"}, "truth": {"trajectory.tum": "truth 2"}}, {})
    untold = stage("map", {"source": {"bag_0.mcap": "bag 1"}}, {})
    elsewhere = stage("map", {"source": {"bag_0.mcap": "bag 1"}, "truth": {"trajectory.tum": "truth 3"}}, {})
    unknown = stage("map", {"source": {"bag_0.mcap": "bag 3", "truth/map.pgm": "room"}}, {})
    group = Group("room", (first, second, of_second, untold, elsewhere, unknown))
    assert group.record_of(of_second) is second
    assert group.record_of(untold) is first
    assert group.record_of(elsewhere) is None
    assert group.record_of(unknown) is None


def test_stages_are_grouped_by_shared_files_and_labelled_uniquely(stages, tmp_path):
    other = fake_record(tmp_path / "other", world="hall")
    groups = group_stages([load_stage(folder) for folder in [stages[2], other, stages[1], stages[2]]])
    labels = {group.name: [stage.label for stage in group.stages] for group in groups}
    assert labels == {"room": ["map", "patrol", "patrol-2"], "hall": ["record"]}
    assert [stage.title for stage in groups[0].stages] == ["Mapping", "Patrol", "Patrol, no. 2"]


@pytest.mark.slow
def test_the_command_prints_the_page_and_refuses_to_overwrite(stages, tmp_path, capsys):
    argv = ["report", str(stages[0]), "--out", str(tmp_path / "out")]
    with unrendered():
        assert main(argv) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "out/index.html")
    assert main(argv) == 2
    assert "already exists" in capsys.readouterr().err


def test_a_changed_output_is_found_by_its_hash(tmp_path):
    stage = load_stage(fake_record(tmp_path / "record"))
    assert changed_files(stage.folder, stage.manifest.outputs) == []
    (tmp_path / "record/truth/trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    assert changed_files(stage.folder, stage.manifest.outputs) == ["truth/trajectory.tum"]


def test_values_are_shown_in_human_units():
    assert shown(0.00875, "cm") == "0.88\u202fcm"
    assert shown(0.25, "cm") == "25.0\u202fcm"
    assert shown(42.676, "cm") == "42.68\u202fm"
    assert [shown(value, "count") for value in (0, 150, 2.5)] == ["0", "150", "2.5"]
    assert [shown(value, "plain") for value in (0.0, 100.0, 0.123456)] == ["0", "100", "0.1235"]
    assert shown(-0.5, "m") == "\u22120.50\u202fm"
    assert shown(3.141592653589793, "deg") == "180.00°"
    assert shown(float("inf"), "m") == shown(None, "m") == "\u2013"


def test_paths_in_commands_are_renamed_by_the_longest_match():
    names = {"data/map": "w/map", "data/map-2": "w/map-2"}
    assert rename("data/map-2/map.yaml", names) == "w/map-2/map.yaml"
    assert rename("data/map", names) == "w/map"
    assert rename("data/mapping", names) == "data/mapping"


@pytest.mark.parametrize("name", ["map", "patrol", "burger", "tour", "RRTConnect", "1"])
def test_an_output_folder_may_be_called_as_any_other_word_of_the_commands_is(name):
    commands = {
        "record": "record --world map --robot burger --teleop tour --seed 1 --out rec",
        "map": f"map --explain rec --truth=rec/truth --out={name} --set front_end=lines --force",
        "patrol": f"navigate --world x --task patrol --robot burger --seed 1 --map {name}/map.yaml --out run",
        "plan": f"plan --map {name} --planner RRTConnect --seed 1 --start 1,2,3 --out plan",
    }
    stages = []
    for label, words in commands.items():
        command = ["turtlebag", *words.split()]
        kind = command[1]
        stages.append(Stage(Path("/far") / label, kind, label, Manifest(stage=kind, command=command)))
    steps = recipe([Group("w", tuple(stages))])
    assert [step.command.removeprefix("turtlebag ") for step in steps] == [
        "record --world map --robot burger --teleop tour --seed 1 --out w/record",
        "map --explain w/record --truth=w/record/truth --out=w/map --set front_end=lines",
        "navigate --world x --task patrol --robot burger --seed 1 --map w/map/map.yaml --out w/patrol",
        "plan --map w/map --planner RRTConnect --seed 1 --start 1,2,3 --out w/plan",
    ]
    assert command_of(stages[1], "A") == (
        "turtlebag map --explain rec --truth=rec/truth --out=A --set front_end=lines"
    )


@pytest.mark.parametrize(
    ("read", "files"),
    [
        ("../rec", {"bag/bag_0.mcap": "1a", "bag/metadata.yaml": "2b"}),
        ("../rec/bag", {"bag_0.mcap": "1a", "metadata.yaml": "2b"}),
        ("../rec/bag/bag_0.mcap", {"bag_0.mcap": "1a"}),
    ],
)
@pytest.mark.parametrize("folder", ["../rec", "report/../../rec", "/far/rec"])
def test_a_recipe_does_not_depend_on_how_a_stage_is_named_or_from_where(read, files, folder):
    record = Manifest(
        stage="record",
        command=["turtlebag", "record", "--out", "data/rec"],
        outputs={"bag/bag_0.mcap": "1a", "bag/metadata.yaml": "2b"},
    )
    source = Input(path=Path(read), sha256=files)
    made = Manifest(stage="map", command=["turtlebag", "map", read, "--out", "m"], inputs={"source": source})
    stages = Stage(Path(folder), "record", "record", record), Stage(Path("m"), "map", "map", made)
    steps = recipe([Group("w", stages)])
    assert steps[1].command == f"turtlebag map {read.replace('../rec', 'w/record')} --out w/map"


PLACES = ("FILE", "DIR", "MAP", "BAG", "MAP_DIR", "INPUT")


def test_every_option_that_takes_a_path_is_known_to_the_recipe():
    for verb in ("record", "teleop", "map", "localise", "navigate", "plan"):
        places = {name for name, value in options(verb).items() if value in PLACES}
        assert {"--config", "--out"} <= places, verb
        for words in ([name, "a/b"] for name in places - {"--out"}):
            command = ["turtlebag", verb, *words, "=".join(words), "--out", "a"]
            made = Stage(Path("a"), verb, "x", Manifest(stage=verb, command=command))
            assert recipe([Group("w", (made,))])[0].command.count("w/x/b") == 2, words


def test_collisions_count_both_kinds_and_plain_numbers():
    assert collision_count({"collisions": {"visible": 1, "low": 2}}) == 3
    assert collision_count({"collisions": 4}) == 4
    assert collision_count({}) == 0


def test_a_log_without_truth_is_told_by_its_relations():
    metrics = {"scans": 10, "relations": {"trans_m": {"mean": 0.01234}}}
    stage = Stage(Path("x"), "map", "map", Manifest(stage="map"))
    assert verdict(stage, metrics) == ("neutral", "10 scans; mean relations error 0.0123\u202fm.")


def test_an_error_names_the_truth_it_was_measured_against():
    manifest = {
        "stage": "map",
        "outputs": {"trajectory.tum": "aa", "map.pgm": "bb"},
        "inputs": {"truth": {"path": "rec/truth", "sha256": {"trajectory.tum": "cc"}}},
    }
    stage = Stage(Path("x"), "map", "map", Manifest.model_validate(manifest))
    ((_, [number]),) = sections_of(stage, {"ate_m": {"rmse": 0.01}}, "room")
    assert number.key == "room/map:ate_m.rmse"
    assert dict(number.files) == {"trajectory.tum": "aa", "truth: trajectory.tum": "cc"}


def test_words_are_linked_once_to_their_meaning_and_the_text_stays_escaped():
    said = explained("loops & SLAM, SLAM")
    assert re.sub(r' title="[^"]*"', "", said) == (
        '<a class="word" href="#word-loop">loops</a> &amp; <a class="word" href="#word-slam">SLAM</a>, SLAM'
    )
    meaning = next(word.meaning for word in WORDS if word.name == "loop")
    assert f'title="{meaning}">loops' in html.unescape(said)
    assert explained("slammed <looping>") == "slammed &lt;looping&gt;"


@pytest.mark.slow
def test_every_word_that_is_linked_is_explained_at_the_end(page):
    text = page.read_text()
    linked = set(re.findall(r'href="#(word-[^"]*)"', text))
    assert {"word-odometry", "word-slam", "word-cell", "word-footprint"} <= linked
    assert linked <= set(re.findall(r'<div id="(word-[^"]*)"', text))


def test_of_the_walls_two_numbers_are_the_ones_to_trust():
    (walls,) = (section for section in SECTIONS["map"] if section.title == "Walls")
    trusted = [spec.path for spec in walls.specs if spec.trusted]
    assert trusted == ["map.occupied_error_m.within_one_cell", "map.coverage"]
    assert all(sum(spec.trusted for spec in s.specs) <= 2 for found in SECTIONS.values() for s in found)


@pytest.mark.slow
def test_the_numbers_come_before_the_details_headline_tiles_verdicts(page):
    text = page.read_text()
    order = [text.index(mark) for mark in ("<h1", 'class="tiles"', 'class="verdicts"', "<nav", "<main")]
    assert order == sorted(order)
