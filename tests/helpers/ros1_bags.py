"""Bags of ROS 1, as `rosbags-convert` makes them of ours."""

from rosbags.convert import convert
from rosbags.typesys import Stores, get_typestore


def to_ros1_bag(folder, file):
    """Convert a rosbag2 folder."""
    store = get_typestore(Stores.LATEST)
    convert([folder], file, "mcap", 9, None, "file", store, None, (), (), (), ())
