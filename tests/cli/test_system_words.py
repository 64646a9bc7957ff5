"""What cannot be another system is refused in a line that says why."""

import pytest

from tests.helpers.report_fakes import fake_map, fake_record
from turtlebag.pipeline.cli.main import main

POSE = "{} 0 0 0 0 0 0 1\n"


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    base = tmp_path_factory.mktemp("words")
    fake_map(base / "map", fake_record(base / "record"))
    for count in (1, 2, 5):
        (base / f"{count}.tum").write_text("".join(POSE.format(second) for second in range(count)))
    (base / "truth.tum").write_text((base / "map/trajectory.tum").read_text())
    (base / "TurtleBag.tum").write_text((base / "map/trajectory.tum").read_text())
    return base


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a=1.tum"], "1.tum: too few poses to compare (1; at least 3 are needed)"),
        (["a=2.tum"], "2.tum: too few poses to compare (2; at least 3 are needed)"),
        (["a=map"], "map: is a folder; give the file of the trajectory in it"),
        (["a=5.tum", "--system-times", "map"], "map: is a folder; give the file of the times in it"),
        (["a="], "a=: names no file; write NAME=FILE"),
        (["=5.tum"], "=5.tum: names no system; write NAME=FILE"),
        (["truth=5.tum"], "truth: this name is taken"),
        (["truth.tum"], "truth: this name is taken"),
        (["TurtleBag.tum"], "TurtleBag: this name is taken"),
    ],
)
def test_what_cannot_be_compared_is_refused_by_its_name(tree, capsys, monkeypatch, words, said):
    monkeypatch.chdir(tree)
    assert main(["compare", "map", *words]) == 2
    assert main(["report", "map", "--system", *words, "--out", "out"]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert said in first == second
    assert not (tree / "out").exists()
