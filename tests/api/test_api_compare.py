"""Comparisons from Python: the bytes of the command, and other systems by their names."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

import turtlebag as tb
from tests.helpers.report_fakes import ellipse, fake_maps, mapped_room, noisy, unrendered
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.datasets.trajectories import load_tum, save_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.cli.main import build_parser, main
from turtlebag.pipeline.stages.parser import joined
from turtlebag.pipeline.stages.verify import verify

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A record, two maps of ours, and another system's trajectory and map."""
    base = tmp_path_factory.mktemp("compare")
    record = fake_maps(base)
    path = noisy(load_tum(record / "truth/trajectory.tum"), 0.03)
    save_tum(Trajectory(path.stamps_ns - 5 * 10**9, path.poses), base / "early.tum")
    save_tum(path, base / "other.tum")
    rows = ["1 0 0 {:.6f} 0 1 0 {:.6f} 0 0 1 0".format(*xy) for xy in ellipse()[::6].xy]
    (base / "kitti.txt").write_text("\n".join(rows))
    (base / "times.txt").write_text("\n".join(f"{k / 5:.1f}" for k in range(150)))
    save_map(mapped_room(), base, "other")
    return base


def made_by_its_command(found, tmp_path):
    """Whether the command that stands in its manifest leaves the same bytes."""
    words = json.loads((found.path / "manifest.json").read_text())["command"]
    assert build_parser(words[1]).parse_args(joined(words[1:])).out == found.path
    assert main([*joined(words[1:]), "--force", "--out", str(tmp_path / "again")]) == 0
    return sha256_tree(found.path) == sha256_tree(tmp_path / "again")


def test_two_outputs_are_compared_as_by_the_command(tree, tmp_path, capfd):
    found = tb.compare(tree / "a", tree / "b")
    assert capfd.readouterr() == ("", "")
    numbers = found.numbers
    row = numbers["number"].tolist().index("ate_m.rmse")
    assert numbers["B"][row] > 2.0 * numbers["A"][row]
    assert "no difference is judged" in found.verdict
    assert "ate_m.rmse" in "".join(ElementTree.fromstring(found._repr_html_()).itertext())
    assert made_by_its_command(found, tmp_path)


def test_other_systems_stand_beside_ours_by_their_names(tree, tmp_path):
    systems = {
        "other": tb.System(tree / "other.tum", map=tree / "other.yaml"),
        "early": tb.System(tree / "early.tum", shift=5.0, base=(0.1, 0.0, 0.0)),
        "kitti": tb.System(tree / "kitti.txt", times=tree / "times.txt"),
        "map": tree / "other.yaml",
    }
    found = tb.compare(tree / "a", systems=systems, out=tmp_path / "beside")
    assert list(found.numbers)[1:] == ["TurtleBag", "other", "early", "kitti", "map"]
    row = found.numbers["number"].tolist().index("ate_aligned_m.rmse")
    assert found.numbers["other"][row] == pytest.approx(0.03 * np.sqrt(2.0), rel=0.1)
    assert np.isnan(found.numbers["map"][row])
    assert found.page.is_file()
    assert any("shifted by 5 s" in note for note in found.notes)
    assert "other 4.2" in found.verdict == tb.Comparison(tmp_path / "beside").verdict
    assert made_by_its_command(found, tmp_path)


def test_a_report_shows_them_and_verify_measures_them_again(tree, tmp_path):
    systems = {"early": tb.System(tree / "early.tum", shift=5.0), "other": tree / "other.yaml"}
    with unrendered():
        report = tb.report(
            tree / "record", tree / "a", systems=systems, animate=False, out=tmp_path / "report"
        )
        assert made_by_its_command(report, tmp_path)
        found = verify(tmp_path / "report", quick=True)
    assert set(report.metrics["room"]["systems"]["systems"]) == {"TurtleBag", "early", "other"}
    assert (found.problems, found.not_run) == ([], [])
    assert "room/systems:systems.early.ate_m.rmse" in {check.key for check in found.checks}


WRONG = {
    "nothing": (lambda t: tb.compare(t / "a"), "^compare: give another output, or other systems"),
    "both": (
        lambda t: tb.compare(t / "a", t / "b", systems={"x": t / "other.tum"}),
        "^compare: give another",
    ),
    "two kinds": (lambda t: tb.compare(t / "a", t / "record"), "nothing to compare"),
    "no name": (
        lambda t: tb.compare(t / "a", systems={"x=y": t / "other.tum"}),
        "^'x=y': a system's name",
    ),
    "nothing of it": (lambda t: tb.compare(t / "a", systems={"x": tb.System()}), "^x has no trajectory"),
    "a map alone": (
        lambda t: tb.compare(t / "a", systems={"x": tb.System(map=t / "other.yaml", shift=1)}),
        "^x has no trajectory",
    ),
    "no seconds": (
        lambda t: tb.compare(t / "a", systems={"x": tb.System(t / "other.tum", shift="1 s")}),
        "^system_shift.0: expected a number of seconds",
    ),
    "half a pose": (
        lambda t: tb.compare(t / "a", systems={"x": tb.System(t / "other.tum", base=(1, 2))}),
        "^system_base.0: expected three numbers",
    ),
    "our name": (lambda t: tb.compare(t / "a", systems={"TurtleBag": t / "other.tum"}), "is taken"),
    "another clock": (
        lambda t: tb.report(t / "a", systems={"x": tb.System(t / "other.tum", shift=-900.0)}),
        r"shift it: --system-shift x=-?\d",
    ),
    "no comparison": (lambda t: tb.Comparison(t / "a"), "is an output of map, not of compare"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_compared_is_said_in_a_line(name, tree):
    call, said = WRONG[name]
    with pytest.raises(tb.InputError, match=said) as error:
        call(tree)
    assert "\n" not in str(error.value)
