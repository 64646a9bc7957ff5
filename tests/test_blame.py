"""Truth in the place of one part: only where it may be, and it does what it says."""

import ast
from pathlib import Path

import numpy as np
import pytest
from report_fakes import fake_record

from datasets.bags.reader import read_poses
from datasets.errors import InputError
from pipeline.campaign.oracle import with_sensors, with_truth
from pipeline.cli import main
from pipeline.slam.slam import SlamConfig
from reports.stages import load_stage

ROOT = Path(__file__).parents[1]


def test_only_the_study_may_import_the_truth():
    users = set()
    for folder in ("datasets", "sim", "planners", "reports", "pipeline"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
                if "pipeline.campaign.oracle" in names:
                    users.add(path.relative_to(ROOT).as_posix())
    assert users == {"pipeline/commands/blame.py"}


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    return fake_record(tmp_path_factory.mktemp("blame") / "record")


def test_each_part_is_replaced_alone(record):
    stage = load_stage(record)
    truth = read_poses(record / "bag", "/ground_truth/odom")
    plain, odometry, deskew = (with_truth(stage, parts) for parts in ([], ["odometry"], ["deskew"]))
    error = np.abs(plain.T_odom_base.xy - stage.truth.poses.xy).max()
    assert error > 0.05
    np.testing.assert_allclose(odometry.T_odom_base.xyt, stage.truth.poses.xyt)
    np.testing.assert_array_equal(deskew.T_odom_base.xyt, plain.T_odom_base.xyt)
    np.testing.assert_array_equal(deskew.odometry.poses.xyt, truth.poses.xyt)
    np.testing.assert_array_equal(odometry.odometry.poses.xyt, plain.odometry.poses.xyt)


def test_true_poses_are_taken_as_they_are():
    assert with_sensors(SlamConfig(), ["poses"]).sensors == "odometry"
    assert with_sensors(SlamConfig(), ["deskew"]).sensors == "both"


def test_what_cannot_be_replaced_is_refused(record, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    assert main(["blame", str(record), "--replace", "luck", *out]) == 2
    assert "known are none, odometry, deskew, poses" in capsys.readouterr().err
    assert main(["blame", str(tmp_path), *out]) == 2
    stage = load_stage(record)
    (record / "truth/trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="one pose for each scan"):
        with_truth(load_stage(stage.folder), ["odometry"])
