"""Messages of every type we read and write beside rosbags' serialiser, whatever their names' lengths."""

import math

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tests.helpers.foreign_bags import STORE, TYPES, S
from turtlebag.datasets.bags import cdr, decode
from turtlebag.datasets.bags.columns import POSES, SAMPLES, Columns
from turtlebag.datasets.bags.decode import BadMessage, Cursor, Ros1Cursor
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Imu, Joints, LidarSpec, Scan, Twist

ROS1 = get_typestore(Stores.ROS1_NOETIC)
STAMP = 1_700_000_123 * S + 456_789_012


def make(store, msgtype, /, **values):
    return store.types[f"{msgtype.split('/')[0]}/msg/{msgtype.split('/')[1]}"](**values)


def header(store, frame, stamp=STAMP):
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, S))
    extra = {"seq": 7} if store is ROS1 else {}
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra)


def vector(store, values, name="Vector3"):
    return store.types[f"geometry_msgs/msg/{name}"](*map(float, values))


def pose(store, xyz, quaternion):
    turn = vector(store, quaternion, "Quaternion")
    return make(store, "geometry_msgs/Pose", position=vector(store, xyz, "Point"), orientation=turn)


GEOMETRY = (
    "angle_min",
    "angle_max",
    "angle_increment",
    "time_increment",
    "scan_time",
    "range_min",
    "range_max",
)


def one_of(layout):
    """Reads one message as a topic of its own."""

    def read(cursor):
        columns = Columns(layout, type(cursor))
        columns.add(0, cursor.data)
        stamps, _, _, numbers = columns.arrays()
        if columns.damaged == [0]:
            raise BadMessage
        return (*stamps.tolist(), *columns.texts[0], *numbers[0].tolist())

    return read


def built(store, rng, frame, child):
    """One message of each type by its name, how it is read, and what that should give."""
    xyz, angular, quaternion, variances = (rng.normal(size=n) for n in (3, 3, 4, 36))
    qx, qy, qz, qw = quaternion
    yaw = math.atan2(2.0 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    at = (*xyz[:2], *quaternion)
    ranges = rng.random(len(frame) + 3).astype(np.float32)
    geometry = [float(np.float32(v)) for v in rng.random(7)]
    place = pose(store, xyz, quaternion)
    speeds = {"linear": vector(store, xyz), "angular": vector(store, angular)}
    motion = make(store, "geometry_msgs/Twist", **speeds)
    turn = vector(store, quaternion, "Quaternion")
    moved = make(store, "geometry_msgs/Transform", translation=vector(store, xyz), rotation=turn)
    link = {"header": header(store, frame), "child_frame_id": child, "transform": moved}
    ours, below = frame.lstrip("/"), child.lstrip("/")
    scan = dict(zip(GEOMETRY, geometry, strict=True)) | {"ranges": ranges, "intensities": ranges}
    pose_told = make(store, "geometry_msgs/PoseWithCovariance", pose=place, covariance=variances)
    twist_told = make(store, "geometry_msgs/TwistWithCovariance", twist=motion, covariance=variances)
    drive = {"child_frame_id": child, "pose": pose_told, "twist": twist_told}
    sample = {
        "orientation": turn,
        "orientation_covariance": variances[:9],
        "angular_velocity": vector(store, angular),
        "angular_velocity_covariance": variances[9:18],
        "linear_acceleration": vector(store, xyz),
        "linear_acceleration_covariance": variances[18:27],
    }
    joints = {"name": ["wheel", child, "x"], "position": xyz, "velocity": xyz, "effort": np.zeros(0)}
    rows = pytest.approx(np.array([[xyz[0], xyz[1], yaw]] * 2))
    linked = (STAMP, ours, below, tuple(xyz), tuple(quaternion), 0)
    yield (
        "sensor_msgs/LaserScan",
        decode.laser_scan,
        scan,
        (STAMP, ours, tuple(geometry), pytest.approx(ranges)),
    )
    moving = xyz[0], xyz[1], angular[2]
    yield (
        "nav_msgs/Odometry",
        one_of(POSES["nav_msgs/msg/Odometry"]),
        drive,
        (STAMP, ours, below, *at, *moving),
    )
    stamped = one_of(POSES["geometry_msgs/msg/PoseStamped"])
    yield "geometry_msgs/PoseStamped", stamped, {"pose": place}, (STAMP, ours, *at)
    yield "geometry_msgs/TransformStamped", decode.transforms, link, [linked] * 2
    yield "sensor_msgs/Imu", one_of(SAMPLES), sample, (STAMP, ours, *angular, *xyz)
    yield "geometry_msgs/Twist", decode.twist, speeds, (xyz[0], angular[2])
    yield "geometry_msgs/TwistStamped", decode.twist_stamped, {"twist": motion}, (xyz[0], angular[2])
    yield "geometry_msgs/PoseArray", decode.pose_array, {"poses": [place, place]}, (STAMP, rows)
    expected = (STAMP, ["wheel", below, "x"], pytest.approx(xyz))
    yield "sensor_msgs/JointState", decode.joint_state, joints, expected


def serialised(store, name, values, layout):
    """Bytes of a message; links become the message of /tf, which ROS 1's types do not have here."""
    message = make(store, name, **values)
    msgtype = name.replace("/", "/msg/")
    if layout == "ros1":
        data = bytes(store.serialize_ros1(message, msgtype))
        return b"\2\0\0\0" + 2 * data if name.endswith("TransformStamped") else data
    if name.endswith("TransformStamped"):
        message, msgtype = TYPES["tf2_msgs/msg/TFMessage"]([message, message]), "tf2_msgs/msg/TFMessage"
    return bytes(store.serialize_cdr(message, msgtype, little_endian=layout == "little"))


@pytest.mark.parametrize("layout", ["little", "big", "ros1"])
@pytest.mark.parametrize("length", range(9))
def test_every_type_is_read_as_it_was_written_and_cut_ones_are_bad(layout, length):
    store = ROS1 if layout == "ros1" else STORE
    rng = np.random.default_rng(length)
    frame, child = ("/" if length % 2 else "") + "f" * length, "c" * (8 - length)
    cursor = Ros1Cursor if layout == "ros1" else Cursor
    for name, decoded, values, expected in built(store, rng, frame, child):
        if name not in ("geometry_msgs/Twist", "geometry_msgs/TransformStamped"):
            values = {"header": header(store, frame), **values}
        data = serialised(store, name, values, layout)
        found = decoded(cursor(data))
        assert (tuple(found) if isinstance(found, tuple) else [tuple(f) for f in found]) == expected
        for cut in {4, 5, 11, 13, 17, 40, len(data) // 2} & set(range(len(data))):
            with pytest.raises(BadMessage):
                decoded(cursor(data[:cut]))


def test_a_sequence_or_text_longer_than_its_message_is_bad():
    for junk in (b"", b"\0\1\0", b"\1\1\0\0", b"\0\2\0\0"):
        with pytest.raises(BadMessage, match="not a CDR message"):
            Cursor(junk)
    assert [Cursor(b"\0" + bytes([k]) + bytes(6)).order for k in (0, 1)] == [">", "<"]
    head = b"\0\1\0\0"
    assert Cursor(head + b"\2\0\0\0" + bytes(8)).count(8) == 2
    with pytest.raises(BadMessage, match="a sequence is longer"):
        Cursor(head + b"\3\0\0\0" + bytes(8)).count(8)
    assert Cursor(head + b"\3\0\0\0ab\0").string() == "ab"
    with pytest.raises(BadMessage, match="a text is longer"):
        Cursor(head + b"\4\0\0\0ab\0").string()
    with pytest.raises(BadMessage, match="too short"):
        Cursor(head + b"\3\0\0").string()
    cursor = Cursor(head + b"\1" + bytes(7) + np.array([1.5, 2.5]).tobytes())
    assert cursor.take("B") == (1,)
    assert cursor.array("f8", 2).tolist() == [1.5, 2.5]
    assert cursor.at == len(cursor.data)
    assert cursor.array("f8", 0).tolist() == []
    with pytest.raises(BadMessage, match="too short"):
        cursor.array("f8", 1)


def test_a_yaw_is_that_of_the_rotation_whatever_the_norm():
    for scale in (1.0, 0.1, 7.0):
        for yaw in (0.0, 1.0, -3.0):
            half = 0.5 * yaw
            found = decode.yaw_of((0.0, 0.0, scale * math.sin(half), scale * math.cos(half)))
            assert found == pytest.approx(yaw)
    for none in ((0.0, 0.0, 0.0, 0.0), (0.0, math.nan, 0.0, 1.0), (math.inf, 0.0, 0.0, 1.0)):
        assert math.isnan(decode.yaw_of(none))


@pytest.mark.parametrize("length", range(9))
def test_what_we_write_has_the_bytes_of_the_reference_serialiser(length):
    rng = np.random.default_rng(length)
    frame, child = "f" * length, "c" * (8 - length)
    poses = SE2(rng.normal(size=(length % 3, 3)))

    def same(data, name):
        message = STORE.deserialize_cdr(data, name)
        assert bytes(STORE.serialize_cdr(message, name)) == data
        return message

    def stamped(message):
        assert message.header.stamp.sec * S + message.header.stamp.nanosec == STAMP
        assert message.header.frame_id == frame

    def placed(message, x, y, yaw):
        at = message.position if hasattr(message, "position") else message.translation
        turn = message.orientation if hasattr(message, "orientation") else message.rotation
        assert (at.x, at.y) == (x, y)
        assert (turn.z, turn.w) == pytest.approx((math.sin(yaw / 2), math.cos(yaw / 2)))
        assert (turn.x, turn.y) == (0.0, 0.0)

    array = same(cdr.pose_array(frame, STAMP, poses), "geometry_msgs/msg/PoseArray")
    stamped(array)
    way = same(cdr.path(frame, STAMP, poses), "nav_msgs/msg/Path")
    stamped(way)
    for one, two, (x, y, yaw) in zip(array.poses, way.poses, poses.xyt, strict=True):
        placed(one, x, y, yaw)
        placed(two.pose, x, y, yaw)
        stamped(two)
    links = [(frame, child, (1.0, 2.0, 3.0), 0.5), (child, frame, (4.0, 5.0, 6.0), -1.5)]
    message = same(cdr.transforms(STAMP, links), "tf2_msgs/msg/TFMessage")
    for link, (parent, name, xyz, yaw) in zip(message.transforms, links, strict=True):
        assert (link.header.frame_id, link.child_frame_id, link.transform.translation.z) == (
            parent,
            name,
            xyz[2],
        )
        assert link.header.stamp.nanosec == STAMP % S
        placed(link.transform, *xyz[:2], yaw)
    cells = rng.integers(-1, 101, (3, length + 1)).astype(np.int8)
    grid = same(
        cdr.occupancy_grid(frame, STAMP, cells, 0.25, np.array([1.0, -2.0, 0.7])),
        "nav_msgs/msg/OccupancyGrid",
    )
    stamped(grid)
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (length + 1, 3, 0.25)
    assert grid.info.map_load_time == grid.header.stamp
    assert grid.data.tolist() == cells.ravel().tolist()
    placed(grid.info.origin, 1.0, -2.0, 0.7)
    points, times = rng.normal(size=(length, 3)).astype(np.float32), rng.random(length).astype(np.float32)
    for given, names in ((None, "xyz"), (times, ("x", "y", "z", "time"))):
        cloud = same(cdr.point_cloud(frame, STAMP, points, given), "sensor_msgs/msg/PointCloud2")
        stamped(cloud)
        assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
            (n, 4 * k, 7, 1) for k, n in enumerate(names)
        ]
        assert (cloud.height, cloud.width, cloud.point_step) == (1, length, 4 * len(names))
        assert (cloud.row_step, cloud.is_dense, cloud.is_bigendian) == (4 * len(names) * length, True, False)
        table = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(length, len(names))
        np.testing.assert_array_equal(table[:, :3], points)
        if given is not None:
            np.testing.assert_array_equal(table[:, 3], times)

    def last(layout, name, *fields):
        """The second of two messages that are packed together."""
        first, second = layout.messages([layout.row(*fields)] * 2)
        assert first == second
        assert layout.size == len(second)
        return same(second, name)

    sample = Imu(STAMP, np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]))
    imu = last(cdr.imu(frame, np.full(9, 0.1), np.full(9, 0.2)), "sensor_msgs/msg/Imu", sample)
    stamped(imu)
    assert imu.orientation_covariance.tolist() == [-1.0] + [0.0] * 8
    assert imu.angular_velocity_covariance.tolist() == [0.1] * 9
    assert imu.linear_acceleration_covariance.tolist() == [0.2] * 9
    assert (imu.orientation.w, imu.orientation.x) == (1.0, 0.0)
    assert (imu.angular_velocity.z, imu.linear_acceleration.x) == (3.0, 4.0)
    wheels = Joints(STAMP, (1, 2), (3.0, 4.0))  # doubles all the same
    joints = last(cdr.joint_state(frame, ["a", child]), "sensor_msgs/msg/JointState", wheels)
    stamped(joints)
    assert (joints.name, joints.position.tolist(), joints.velocity.tolist()) == (
        ["a", child],
        [1.0, 2.0],
        [3.0, 4.0],
    )
    pose = SE2.from_xyt(1.0, 2.0, 0.5)
    odometry, about = cdr.odometry(frame, child, np.arange(36.0)), (STAMP, pose, Twist(3.0, 4.0))
    drive = last(odometry, "nav_msgs/msg/Odometry", *about)
    stamped(drive)
    assert drive.child_frame_id == child
    placed(drive.pose.pose, 1.0, 2.0, 0.5)
    assert drive.pose.covariance.tolist() == np.arange(36.0).tolist()
    assert (drive.twist.twist.linear.x, drive.twist.twist.angular.z) == (3.0, 4.0)
    assert not drive.twist.covariance.any()
    lidar = LidarSpec(length + 1, 0.5, 0.25, 1.0, 6.0, 0.125, 0.75)
    ranges = np.arange(length + 1, dtype=np.float32)
    scan = same(cdr.laser_scan(frame, Scan(STAMP, ranges, lidar)), "sensor_msgs/msg/LaserScan")
    stamped(scan)
    assert (scan.angle_min, scan.angle_max, scan.angle_increment) == (0.5, 0.5 + 0.25 * length, 0.25)
    assert (scan.time_increment, scan.scan_time, scan.range_min, scan.range_max) == (0.125, 0.75, 1.0, 6.0)
    assert (scan.ranges.tolist(), len(scan.intensities)) == (ranges.tolist(), 0)
    at = same(
        cdr.pose_with_covariance(frame, STAMP, pose, np.ones((3, 3))),
        "geometry_msgs/msg/PoseWithCovarianceStamped",
    )
    stamped(at)
    placed(at.pose.pose, 1.0, 2.0, 0.5)
    assert at.pose.covariance.sum() == 9.0
    (link,) = last(cdr.transform(frame, child), "tf2_msgs/msg/TFMessage", STAMP, pose).transforms
    stamped(link)
    assert link.child_frame_id == child
    placed(link.transform, 1.0, 2.0, 0.5)
    moving = last(cdr.twist(), "geometry_msgs/msg/Twist", Twist(3.0, 4.0))
    assert (moving.linear.x, moving.angular.z) == (3.0, 4.0)
    goal = same(cdr.pose_stamped(frame, STAMP, pose), "geometry_msgs/msg/PoseStamped")
    stamped(goal)
    placed(goal.pose, 1.0, 2.0, 0.5)


def test_a_planar_covariance_stands_in_the_rows_of_x_y_and_yaw():
    given = np.arange(9.0).reshape(3, 3)
    full = np.array(cdr.planar_covariance(given)).reshape(6, 6)
    np.testing.assert_array_equal(full[np.ix_((0, 1, 5), (0, 1, 5))], given)
    assert np.count_nonzero(full) == 8


def test_many_poses_that_fill_their_message_to_the_end_are_read_back():
    poses = SE2(np.random.default_rng(4).uniform(-3.0, 3.0, (100, 3)))
    stamp, found = decode.pose_array(Cursor(cdr.pose_array("map", STAMP, poses)))
    assert stamp == STAMP
    np.testing.assert_allclose(found, poses.xyt, atol=1e-9)
