"""YAML whose text is short and whose values are endless: refused in one line, by every reader, at once."""

import sqlite3
from contextlib import closing

import pytest
from mcap.writer import Writer

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.yaml_files import MOST_VALUES, parsed
from turtlebag.pipeline.cli.main import main

WIDE, DEEP = 9, 9


def tower(opening: str, closing: str, first: str) -> str:
    """Lines that each name the one before nine times, nine deep."""
    lines = [f"a0: &a0 {first}"]
    for depth in range(1, DEEP + 1):
        lines.append(f"a{depth}: &a{depth} {opening}{', '.join([f'*a{depth - 1}'] * WIDE)}{closing}")
    return "\n".join(lines) + "\n"


MERGES = tower("{<<: [", "]}", "{k: 1, l: 2}")
LISTS = tower("[", "]", "[1, 2]")


def to(bag, out, storage):
    return str(bag), "--out", str(out), "--storage", storage


@pytest.mark.parametrize("text", [MERGES, LISTS, "a: &a [1, *a]\n"])
def test_aliases_are_bounded_by_what_they_write_out(text):
    with pytest.raises(InputError, match="a file: more than 1000000 values"):
        parsed(text, where="a file")


def test_plain_yaml_of_many_values_and_few_aliases_is_read():
    items = ", ".join(["1"] * 1000)
    found = parsed(f"a: &a [{items}]\nb: [{', '.join(['*a'] * 100)}]\nc: {{<<: {{d: 1}}}}\n", where="a file")
    assert (len(found["b"]), sum(map(len, found["b"])), found["c"]) == (100, 100_000, {"d": 1})
    assert parsed("1:" * 50_000 + "1", where="a file") == "1:" * 50_000 + "1"  # once took the square of it
    with pytest.raises(InputError, match="more than"):
        parsed("[" + "1," * (MOST_VALUES + 1) + "]", where="a file")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("world.yaml", "record --world FILE --teleop arena_lap --out out"),
        ("robot.yaml", "record --world turtlebot3_world --robot FILE --teleop arena_lap --out out"),
        ("script.yaml", "record --world turtlebot3_world --teleop FILE --out out"),
        ("settings.yaml", "record --world turtlebot3_world --teleop arena_lap --config FILE --out out"),
        ("map.yaml", "plan --map FILE --start 0,0,0 --goal 1,0,0 --out out"),
        ("places.yaml", "navigate --world turtlebot3_world --task patrol --waypoints FILE --out out"),
        ("session.yaml", "studio --replay FILE --out out"),
        ("campaign.yaml", "sweep FILE --out out"),
        ("edits.yaml", "map bag --edits FILE --out out"),
    ],
)
def test_every_command_refuses_such_a_file_at_once(tmp_path, monkeypatch, capsys, name, words):
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "bag", seconds=1.0)
    (tmp_path / name).write_text(MERGES)
    assert main(words.replace("FILE", f"./{name}").split()) == 2
    said = capsys.readouterr().err
    assert f"{name}: more than 1000000 values" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_so_does_a_setting_of_the_command_line(tmp_path, capsys):
    write_drive(tmp_path / "bag", seconds=1.0)
    value = "[" + "&a [1], " + "".join(f"&a [{', '.join(['*a'] * 9)}], " for _ in range(9)) + "]"
    bag, out = str(tmp_path / "bag"), str(tmp_path / "out")
    assert main(["map", bag, "--set", f"slam.deskew={value}", "--out", out]) == 2
    assert "more than 1000000 values" in capsys.readouterr().err


def test_a_bag_whose_metadata_is_such_yaml_is_read_without_it(tmp_path):
    scans = write_drive(tmp_path / "bag", seconds=2.0)
    (tmp_path / "bag/metadata.yaml").write_text(MERGES)
    bag = open_bag(tmp_path / "bag")
    assert sum(message.topic.name == "/scan" for message in bag.messages()) == scans
    assert bag.notes[0].startswith("metadata.yaml cannot be used (more than 1000000 values")


def test_topics_of_an_sqlite_bag_are_bounded_too(tmp_path, capsys):
    write_drive(tmp_path / "bag", seconds=1.0)
    assert main(["bag", "convert", *to(tmp_path / "bag", tmp_path / "db", "sqlite3")]) == 0
    (file,) = (tmp_path / "db/bag").glob("*.db3")
    with closing(sqlite3.connect(file)) as db, db:
        db.execute("UPDATE topics SET offered_qos_profiles = ?", (MERGES,))
    assert main(["bag", "info", str(file)]) == 2
    assert "damaged bag (more than 1000000 values" in capsys.readouterr().err


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("qos", [MERGES, "- [", "7", "- 7"])
def test_a_copy_leaves_out_a_quality_of_service_that_cannot_be_read(tmp_path, capsys, storage, qos):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Bool", "ros2msg", b"bool data")
        channel = writer.register_channel("/b", "cdr", schema, {"offered_qos_profiles": qos})
        writer.add_message(channel, 1, b"\0\1\0\0\1", 1)
        writer.finish()
    assert main(["bag", "convert", *to(tmp_path / "a.mcap", tmp_path / "out", storage)]) == 0
    assert "/b: its quality of service cannot be read and is left out" in capsys.readouterr().err
    assert [message.data for message in open_bag(tmp_path / "out").messages()] == [b"\0\1\0\0\1"]
