"""A report with every picture, which takes seconds to draw."""

import pytest

from tests.helpers.made_once import made_once
from tests.helpers.report_fakes import fake_map, fake_record, fake_run
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.report import make_report


def make(folder):
    record = fake_record(folder / "record")
    run = fake_run(folder / "run", fake_map(folder / "map", record), missed=True)
    make_report([record, folder / "map", run], Output(folder / "report"))


@pytest.fixture(scope="session")
def drawn(tmp_path_factory):
    """`record`, `map`, `run` with a goal missed, and the `report` of them; nobody writes to them."""
    return made_once(tmp_path_factory, "drawn", make)
