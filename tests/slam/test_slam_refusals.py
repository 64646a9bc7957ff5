"""Logs and settings of which no map can be made: one sentence each."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_rays import rectangle
from tests.helpers.slam_rooms import LDS, ROOM, around_the_room, drifted, recording
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.slam.graph.edits import AddedLoop, Edits, RejectedLoop
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam

POSES = around_the_room(60)[:20]
LOG = recording(ROOM, POSES, odometry=POSES)
WITHOUT = replace(LOG, T_odom_base=None)
BLIND = SlamConfig(sensors="odometry")
NOT_THERE = Edits(add=(AddedLoop(scan=150, place=0, pose=(0, 0, 0)),))
BESIDE = Edits(reject=(RejectedLoop(scan=10, place=12),))


def hall():
    """Another place than ROOM, and a log of it."""
    t = np.linspace(0.0, 6.0, 60)
    poses = np.stack([1.0 + t, np.full(60, 2.0), np.zeros(60)], axis=1)
    return recording(rectangle(0, 0, 9, 4), poses, odometry=poses)


@pytest.mark.parametrize(
    ("log", "config", "more", "said"),
    [
        (WITHOUT, BLIND, {}, "^test: no odometry, which sensors=odometry needs$"),
        (WITHOUT, SlamConfig(front_end="wheels"), {}, "^test: no odometry, which front_end=wheels needs$"),
        (
            LOG,
            SlamConfig(front_end="wheels", sensors="lidar"),
            {},
            "needs the odometry that sensors=lidar leaves",
        ),
        (
            LOG,
            SlamConfig(front_end="kiss_icp", sensors="odometry"),
            {},
            "needs the scans that sensors=odometry",
        ),
        (replace(LOG, stamps_ns=LOG.stamps_ns[:0], ranges=LOG.ranges[:0]), SlamConfig(), {}, "no scans"),
        (
            LOG,
            SlamConfig(),
            {"edits": NOT_THERE},
            "^--edits: add 1: test has no scan 150; its scans are numbered 0 to 19$",
        ),
        (LOG, SlamConfig(), {"edits": BESIDE}, "scans 10 and 12 were taken shortly after each other"),
        (LOG, BLIND, {"more": [LOG]}, "joining it to .* needs scans"),
        (
            LOG,
            SlamConfig(),
            {"more": [recording(ROOM, POSES, replace(LDS, range_max=7.0), odometry=POSES)]},
            "lidar",
        ),
    ],
)
def test_what_cannot_be_mapped_is_said(log, config, more, said):
    with pytest.raises(InputError, match=said) as caught:
        run_slam(log, config, **more)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_second_session_somewhere_else_joins_nothing():
    poses = around_the_room(120)
    with pytest.raises(InputError, match=r"no place of .* recognised; map it separately$"):
        run_slam(recording(ROOM, poses, odometry=drifted(poses)), SlamConfig(), more=[hall()])
