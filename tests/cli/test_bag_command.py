"""`turtlebag bag`: what the verbs print and how they end."""

import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.cli.main import main


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive") / "bag"
    write_drive(folder, seconds=4)
    return folder


def test_info_prints_each_topic_with_count_and_rate(drive, capsys):
    assert main(["bag", "info", str(drive)]) == 0
    lines = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line}
    assert lines["/scan"][1:4] == ["sensor_msgs/msg/LaserScan", "20", "5.00"]
    assert lines["/odom"][2:4] == ["120", "30.00"]
    assert lines["seed"] == ["seed", "7"]


def test_recover_makes_a_whole_bag_of_an_unfinished_one(drive, tmp_path, capsys):
    partial = tmp_path / "rec.partial" / "bag"
    partial.mkdir(parents=True)
    whole = (drive / "bag_0.mcap").read_bytes()
    (partial / "bag_0.mcap").write_bytes(whole[: len(whole) // 2])
    assert main(["bag", "recover", str(tmp_path / "rec.partial"), "--out", str(tmp_path / "rec")]) == 0
    expected = [message[1:] for message in open_bag(drive).messages()]
    saved = [message[1:] for message in open_bag(tmp_path / "rec").messages()]
    assert saved == expected[: len(saved)]
    assert 0.2 < len(saved) / len(expected) < 0.6
    assert (tmp_path / "rec" / "manifest.json").is_file()
    with AnyReader([tmp_path / "rec" / "bag"]) as reader:
        assert reader.message_count == len(saved)


@pytest.mark.slow
@pytest.mark.parametrize("options", [["--out", "x"], ["--out", "x", "--storage", "sqlite3"]])
def test_convert_writes_what_map_reads(drive, tmp_path, monkeypatch, options):
    monkeypatch.chdir(tmp_path)
    assert main(["bag", "convert", str(drive), *options]) == 0
    recording = load_recording(tmp_path / options[1])
    assert recording.stamps_ns.tolist() == load_recording(drive).stamps_ns.tolist()
    assert sorted(path.name for path in tmp_path.iterdir()) == [options[1]]
    assert main(["bag", "convert", str(drive), *options]) == 2
    assert main(["bag", "convert", str(drive), *options, "--force"]) == 0


def test_a_ros1_bag_is_not_written_but_what_writes_it_is_named(drive, tmp_path, capsys):
    out = tmp_path / "a.bag"
    assert main(["bag", "convert", str(drive), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"--out {out}: ROS 1 bags are read but not written; use `rosbags-convert --src {drive}" in said
    words = said.rpartition("`rosbags-convert ")[2].rstrip("`\n").split()
    command = Path(sys.executable).with_name("rosbags-convert")
    subprocess.run([command, *words], check=True, capture_output=True)
    assert load_recording(out).stamps_ns.tolist() == load_recording(drive).stamps_ns.tolist()


def test_info_of_a_carmen_log(tmp_path, capsys):
    line = "FLASER 180 " + "1.00 " * 180 + "0 0 0 0 0 0 {}.5 nohost 0\n"
    (tmp_path / "a.log").write_text("".join(line.format(k) for k in range(4)))
    assert main(["bag", "info", str(tmp_path / "a.log")]) == 0
    out = capsys.readouterr().out
    assert "4 scans, 3.00 s, one every 1.000 s" in out
    assert "180 beams from -90.0 to 89.0 degrees" in out
