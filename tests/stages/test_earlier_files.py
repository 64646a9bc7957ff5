"""Files of an earlier version, kept as it wrote them, with the paths shortened: they are still read."""

from pathlib import Path

import numpy as np

from turtlebag.pipeline.slam.session_file import load_session as load_graph
from turtlebag.pipeline.studio.journal import load_session

EARLIER = Path(__file__).with_name("earlier")


def test_the_graph_of_a_map_is_read():
    session, config = load_graph(EARLIER)
    assert len(session.recording.stamps_ns) == 14
    assert config.front_end == "lines"
    last = session.track.T_track_base.xyt[-1]
    np.testing.assert_allclose(last, [0.298, 0.050, 2.0 * np.arctan2(0.2224, 0.9750)], atol=0.01)


def test_the_session_of_a_studio_is_read():
    recorded = load_session(EARLIER / "session.yaml")
    kinds = ["record", "pose_estimate", "patrol", "keepout", "box", "waypoints_save", "map_save", "end"]
    assert [action.do for _, action in recorded.actions] == kinds
    assert (len(recorded.script), recorded.until_ns) == (2, 1_200_000_000)
