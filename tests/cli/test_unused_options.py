"""An option that a command would not look at is refused by name, with nothing written."""

import pytest

from tests.helpers.fuzz_cases import carmen_log
from turtlebag.pipeline.cli.main import main


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["bag", "convert", "x.mcap", "--out", "x.bag"], "--out x.bag: ROS 1 bags are read but not written"),
        (["bag", "convert", "drive.clf", "--exclude", "/odom", "--out", "rec"], "--exclude"),
        (["report", ".", "--index", "--paper", "--out", "page"], "--paper"),
        (["report", ".", "--index", "--no-animation", "--out", "page"], "--no-animation"),
        (["report", ".", "--index", "--system-shift", "1", "--out", "page"], "--system-shift"),
        (["sweep", ".", "--query", "select 1", "--out", "study"], "--out"),
        (["sweep", ".", "--query", "select 1", "--workers", "2"], "--workers"),
    ],
)
def test_an_option_without_use_is_refused_by_name(tmp_path, monkeypatch, capsys, words, option):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.clf").write_text(carmen_log())
    (tmp_path / "x.mcap").touch()
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"turtlebag: {option}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.clf", "x.mcap"]
