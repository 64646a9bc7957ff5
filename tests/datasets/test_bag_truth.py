"""Mapping cannot see the truth: without it in the bag or beside it, the map is the same."""

import json

import pytest

from turtlebag.datasets.bags.convert import to_mcap
from turtlebag.datasets.bags.selection import Selection
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.pipeline.stages.requests.maps import MapRequest

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
    to_mcap(
        tmp_path / "with" / "bag", tmp_path / "without" / "bag", Selection(exclude=("/ground_truth/odom",))
    )
    topics = {message.topic.name for message in open_bag(tmp_path / "without").messages()}
    assert "/scan" in topics
    assert not any(topic.startswith("/ground_truth") for topic in topics)
    for name, truth in (("with", tmp_path / "with" / "truth"), ("without", None)):
        build_map(MapRequest(source=tmp_path / name, truth=truth), Output(tmp_path / f"map_{name}"))
    told, untold = tmp_path / "map_with", tmp_path / "map_without"
    for name in ("map.pgm", "map.yaml", "trajectory.tum", "graph.g2o"):
        assert (told / name).read_bytes() == (untold / name).read_bytes(), name
    metrics, fewer = (json.loads((folder / "metrics.json").read_text()) for folder in (told, untold))
    assert metrics["ate_m"]["rmse"] < 0.03
    assert metrics == {**metrics, **fewer}
