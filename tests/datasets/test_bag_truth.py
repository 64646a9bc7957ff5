"""Mapping cannot see the truth: without it in the bag and beside it, every output is the same."""

import pytest

from turtlebag.datasets.bags.convert import to_mcap
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.pipeline.stages.sources import MapInputs, Source

pytestmark = pytest.mark.slow

SCRIPT = """
name: short
v: 0.2
w: 0.6
steps:
  - drive: 0.6
  - turn_deg: 90
  - drive: 0.4
  - turn_deg: -90
  - drive: 0.4
"""


def test_a_map_without_the_truth_is_the_same_to_the_byte(tmp_path):
    (tmp_path / "short.yaml").write_text(SCRIPT)
    record(Scene.load("turtlebot3_world", seed=3), str(tmp_path / "short.yaml"), Output(tmp_path / "with"))
    to_mcap(tmp_path / "with" / "bag", tmp_path / "without" / "bag", exclude=["/ground_truth/odom"])
    topics = {message.topic.name for message in open_bag(tmp_path / "without").messages()}
    assert "/scan" in topics
    assert not any(topic.startswith("/ground_truth") for topic in topics)
    for name in ("with", "without"):
        build_map(MapInputs(Source(tmp_path / name)), Output(tmp_path / f"map_{name}"))
    for name in ("map.pgm", "map.yaml", "trajectory.tum", "graph.g2o", "metrics.json"):
        assert (tmp_path / "map_with" / name).read_bytes() == (
            tmp_path / "map_without" / name
        ).read_bytes(), name
