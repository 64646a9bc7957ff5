"""Lines of CARMEN logs."""

import numpy as np

NO_RETURN_M = 81.83
"""How a SICK's log says "nothing came back"."""


def flaser(ranges, laser=(0.0, 0.0, 0.0), robot=(0.0, 0.0, 0.0), stamp="12.345678"):
    readings = " ".join(f"{r:.2f}" for r in ranges)
    poses = " ".join(f"{v:.6f}" for v in (*laser, *robot))
    return f"FLASER {len(ranges)} {readings} {poses} {stamp} nohost 0.5\n"


def write(tmp_path, text, name="a.clf"):
    path = tmp_path / name
    path.write_text(text)
    return path


def carmen_text(log):
    """The first 180 beams of a recording, from the robot's centre, and its odometry, as FLASER lines."""
    ranges = np.where(np.isfinite(log.ranges), log.ranges, NO_RETURN_M)[:, :180]
    poses, stamps = log.T_odom_base.xyt, log.stamps_ns * 1e-9
    return "".join(flaser(ranges[k], poses[k], poses[k], f"{stamps[k]:.6f}") for k in range(len(log)))
