"""The topics that a run publishes from its localiser."""

from types import SimpleNamespace

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Joints, LidarSpec, Observation, Odometry, Scan, Twist
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.sensing import OdometryBuffer

TICK_NS = 200_000_000
LIDAR = LidarSpec(4, 0.0, np.pi / 2, 0.12, 3.5)


def observation(k):
    stamp, pose = k * TICK_NS, SE2.from_xyt(0.04 * k, 0.0, 0.0)
    scan = Scan(stamp, np.ones(4, dtype=np.float32), LIDAR)
    return Observation(stamp, Odometry(stamp, pose, Twist()), Joints(stamp, (0.0, 0.0), (0.0, 0.0)), scan)


def test_a_cloud_is_published_only_at_a_scan_that_the_filter_used():
    amcl = SimpleNamespace(
        initialised=True, T_map_odom=SE2.identity(), covariance=np.eye(3), beams=None,
        converged=True, agrees=True, lost=False, searches=0, agreement=1.0,
    )  # fmt: skip
    used = {0, 2, 7, 13, 14}
    amcl.particles = SE2.identity(3)

    def update(scan, T_odom_base, T_odom_base_end):
        k = scan.stamp_ns // TICK_NS
        if k in used:
            amcl.particles = SE2(np.repeat(T_odom_base.xyt[None], 3, axis=0))
        return k in used

    amcl.update = update
    published = []
    publisher = SimpleNamespace(
        particles=lambda stamp_ns, cloud: published.append((stamp_ns // TICK_NS, float(cloud.x[0]))),
        map_to_odom=lambda *of: None,
        amcl_pose=lambda *of: None,
    )
    odometry = OdometryBuffer()
    localiser = OnlineLocaliser(amcl, odometry, publisher)
    for k in range(20):
        odometry.add(k * TICK_NS, observation(k).odometry.T_odom_base)
        localiser.observe(observation(k))
    # Once a second at most; each where odometry was at its stamp.
    assert published == [(k, pytest.approx(0.04 * k)) for k in (0, 7, 13)]
