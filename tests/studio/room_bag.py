"""A short bag of a room, for the tests of playing bags."""

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.types import Odometry, Scan, Twist
from turtlebag.pipeline.slam.mapper import SlamConfig

TRUE = around_the_room(150)
LOG = recording(ROOM, TRUE, odometry=drifted(TRUE))
LAST = len(LOG) - 1
WITH_LOOPS = SlamConfig.model_validate({"loops": {"held_m": 0.0}})
"""In a room this small the refinement would do without loops."""


def write_bag(folder, log=LOG, **custom):
    """A log as a rosbag2 folder."""
    with BagWriter(folder, custom=custom) as writer:
        writer.static_transforms(0, [("base_footprint", "base_scan", (0.0, 0.0, 0.1), 0.0)])
        for k in range(len(log)):
            stamp = int(log.stamps_ns[k])
            writer.odometry(Odometry(stamp, log.T_odom_base[k], Twist()))
            writer.scan(stamp, Scan(stamp, log.ranges[k], log.lidar))
    return folder
