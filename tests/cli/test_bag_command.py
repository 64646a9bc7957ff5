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


def test_info_loads_nothing_that_it_does_not_need(drive):
    program = (
        "import sys; from turtlebag.pipeline.cli.main import main; main(sys.argv[1:]); "
        "slow = {'rich', 'numba', 'turtlebag.datasets.outputs', 'importlib.metadata'}; "
        "print(sorted(slow & set(sys.modules)))"
    )
    command = [sys.executable, "-c", program, "bag", "info", str(drive)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert said.splitlines()[-1] == "[]"


def test_info_of_no_bag_is_one_line_and_exit_2(tmp_path, capsys):
    assert main(["bag", "info", str(tmp_path / "nothing")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "nothing: no such file" in captured.err


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


def test_recover_of_nothing_writes_nothing(tmp_path, capsys):
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert main(["bag", "recover", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap"]


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


def test_convert_does_not_make_a_folder_named_as_a_packed_bag(drive, tmp_path, capsys):
    assert main(["bag", "convert", str(drive), "--out", str(tmp_path / "a.bag.gz")]) == 2
    assert capsys.readouterr().err.endswith("a.bag.gz: bags are written unpacked; leave out .gz\n")
    assert not any(tmp_path.iterdir())


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


def test_a_topic_to_leave_out_must_be_there(drive, tmp_path, capsys):
    assert main(["bag", "convert", str(drive), "--exclude", "/tf_statik", "--out", str(tmp_path / "x")]) == 2
    assert "--exclude /tf_statik: no such topic; " in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_info_of_a_carmen_log(tmp_path, capsys):
    line = "FLASER 180 " + "1.00 " * 180 + "0 0 0 0 0 0 {}.5 nohost 0\n"
    (tmp_path / "a.log").write_text("".join(line.format(k) for k in range(4)))
    assert main(["bag", "info", str(tmp_path / "a.log")]) == 0
    out = capsys.readouterr().out
    assert "4 scans, 3.00 s, one every 1.000 s" in out
    assert "180 beams from -90.0 to 89.0 degrees" in out
