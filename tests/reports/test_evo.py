"""Our numbers are those that evo prints: by evo itself where it is installed, else by what it printed."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.report_fakes import fake_map, fake_record
from tests.reports.evo_samples import estimate, reference
from turtlebag.datasets.trajectories import save_tum_3d
from turtlebag.reports.metrics import evo as ours
from turtlebag.reports.metrics.systems import path_errors

WITHOUT = importlib.util.find_spec("evo") is None
needs_evo = pytest.mark.skipif(
    WITHOUT, reason="no evo here: `pip install evo` (our numbers are checked anyway)"
)

# What `evo_ape tum reference.tum estimate.tum` and `evo_rpe ...` (evo 1.38.1) printed of evo_samples.
PRINTED = {
    "ape": (6.946129, 4.528651, 4.853917, 0.791257, 4.906092, 1.887077),
    "ape -a": (0.031093, 0.019508, 0.019873, 0.005068, 0.020243, 0.005402),
    "rpe -d 1 -u f": (0.050156, 0.027706, 0.029983, 0.004880, 0.029267, 0.009431),
    "rpe -d 1 -u f -r angle_deg": (3.350793, 2.290174, 2.298153, 0.365469, 2.350220, 0.527859),
    "rpe -d 1 -u m": (0.049882, 0.028128, 0.031916, 0.010263, 0.029994, 0.010414),
    "rpe -d 1 -u m -r angle_deg": (2.616554, 1.866587, 1.806148, 1.212773, 1.911312, 0.411057),
}


@pytest.fixture(scope="module")
def found():
    return path_errors(ours.pair(estimate(), reference()))


def table(found):
    """Our numbers by the evo command that prints them."""
    return {
        "ape": found["ate_m"],
        "ape -a": found["ate_aligned_3d_m"],
        "rpe -d 1 -u f": found["rpe_frame"]["trans_m"],
        "rpe -d 1 -u f -r angle_deg": found["rpe_frame"]["rot_deg"],
        "rpe -d 1 -u m": found["rpe_metre"]["trans_m"],
        "rpe -d 1 -u m -r angle_deg": found["rpe_metre"]["rot_deg"],
    }


def test_our_numbers_are_those_that_evo_printed(found):
    assert found["paired"] == 103
    for command, statistics in table(found).items():
        printed = dict(zip(("max", "mean", "median", "min", "rmse", "std"), PRINTED[command], strict=True))
        assert statistics == pytest.approx(printed, abs=1e-6), command


@needs_evo
def test_our_numbers_are_those_of_the_evo_that_is_here(found, tmp_path):
    from evo.core.metrics import PoseRelation, Unit
    from evo.core.sync import associate_trajectories
    from evo.main_ape import ape
    from evo.main_rpe import rpe
    from evo.tools.file_interface import read_tum_trajectory_file

    def read():
        both = []
        for name, track in (("reference", reference()), ("estimate", estimate())):
            save_tum_3d(track.stamps_ns, track.T, tmp_path / f"{name}.tum")
            both.append(read_tum_trajectory_file(tmp_path / f"{name}.tum"))
        return associate_trajectories(*both)

    mine = table(found)
    for command, statistics in mine.items():
        kind, *options = command.split()
        relation = (
            PoseRelation.rotation_angle_deg if "angle_deg" in options else PoseRelation.translation_part
        )
        if kind == "ape":
            result = ape(*read(), relation, align="-a" in options)
        else:
            unit = Unit.meters if "m" in options else Unit.frames
            result = rpe(*read(), relation, delta=1, delta_unit=unit)
        for name, value in statistics.items():
            assert result.stats[name] == pytest.approx(value, abs=1e-6), (command, name)


@needs_evo
def test_evo_traj_plots_our_trajectory_beside_the_truth(tmp_path):
    record = fake_record(tmp_path / "record")
    mapped = fake_map(tmp_path / "map", record)
    files = [str(mapped / "trajectory.tum"), "--ref", str(record / "truth/trajectory.tum")]
    program = str(Path(sys.executable).with_name("evo_traj"))
    command = [program, "tum", *files, "--save_plot", str(tmp_path / "plot.png")]
    told = subprocess.run(
        command,
        env={**os.environ, "HOME": str(tmp_path), "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
    )
    assert told.returncode == 0, told.stderr
    assert "150 poses" in told.stdout
    plots = list(tmp_path.glob("plot*.png"))
    assert plots
    assert all(path.stat().st_size > 5000 for path in plots)


def test_stamps_that_never_meet_are_interpolated_but_not_over_a_gap():
    truth = reference()
    half = estimate()
    half = half[(half.stamps_ns > truth.stamps_ns[2]) & (half.stamps_ns < truth.stamps_ns[-2])]
    half.stamps_ns[:] += 100_000_000
    paired = ours.pair(half, truth)
    assert paired.interpolated
    assert len(paired) == len(half)
    k = int(np.searchsorted(truth.stamps_ns, paired.reference.stamps_ns[10]))
    low, high, between = truth.T[k - 1, :3, 3], truth.T[k, :3, 3], paired.reference.T[10, :3, 3]
    whole = np.linalg.norm(high - low)
    assert np.linalg.norm(between - low) + np.linalg.norm(high - between) == pytest.approx(whole, rel=1e-3)
    holed = truth[(np.arange(len(truth)) < 40) | (np.arange(len(truth)) > 80)]
    kept = ours.pair(half, holed).estimate.stamps_ns
    assert not np.any((kept > truth.stamps_ns[39]) & (kept < truth.stamps_ns[81]))
    assert 40 < len(kept) < len(half)
