"""Offline localisation and plans in a report."""

import json

import pytest
from report_fakes import fake_localise, fake_map, fake_plan, fake_record

from datasets.errors import InputError
from pipeline.report import make_report
from pipeline.verify import verify
from reports.draw_localise import read_path


def test_localisation_and_plan_stand_with_their_world_and_verify(tmp_path):
    record = fake_record(tmp_path / "record")
    built = fake_map(tmp_path / "map", record)
    located = fake_localise(tmp_path / "localise", record, built)
    plan = fake_plan(tmp_path / "plan", built)
    page = make_report([plan, located, built, record], tmp_path / "out", animate=False).read_text()
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert list(metrics) == ["room"]
    assert list(metrics["room"]) == ["record", "map", "localise", "plan"]
    assert "Localised, " in page
    assert "A path was found." in page
    found = verify(tmp_path / "out")
    assert found.problems == []
    assert "room/localise:localisation_error_m.rmse" in {check.key for check in found.checks}


@pytest.mark.parametrize("text", ["", "x,y\n1,2\n", "x,y,yaw\n1,2,three\n", "x,y,yaw\n"])
def test_what_is_no_path_is_bad_input(text, tmp_path):
    (tmp_path / "path.csv").write_text(text)
    with pytest.raises(InputError):
        read_path(tmp_path / "path.csv")
