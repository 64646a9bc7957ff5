"""Lines of CARMEN logs."""


def flaser(ranges, laser=(0.0, 0.0, 0.0), robot=(0.0, 0.0, 0.0), stamp="12.345678"):
    readings = " ".join(f"{r:.2f}" for r in ranges)
    poses = " ".join(f"{v:.6f}" for v in (*laser, *robot))
    return f"FLASER {len(ranges)} {readings} {poses} {stamp} nohost 0.5\n"


def write(tmp_path, text, name="a.clf"):
    path = tmp_path / name
    path.write_text(text)
    return path


def carmen_text(log):
    """The first 180 beams of a recording and its odometry, as FLASER lines."""
    lines = []
    for k in range(len(log)):
        x, y, yaw = log.T_odom_base.xyt[k]
        pose = f"{x:.6f} {y:.6f} {yaw:.6f}"
        readings = " ".join(f"{r:.3f}" for r in log.ranges[k, :180])
        lines.append(f"FLASER 180 {readings} {pose} {pose} {log.stamps_ns[k] / 1e9:.6f} host {k * 0.2:.6f}")
    return "\n".join(lines) + "\n"
