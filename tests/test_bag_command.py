"""`turtlebag bag`: what the verbs print and how they end."""

import pytest
from bag_samples import write_drive

from pipeline.cli import main


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


def test_info_of_no_bag_is_one_line_and_exit_2(tmp_path, capsys):
    assert main(["bag", "info", str(tmp_path / "nothing")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "nothing: no such file" in captured.err
