"""How the base follows commands: its delay and its accelerations, by /cmd_vel and the odometry's speeds."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording, Stamps
from turtlebag.pipeline.identify.estimates import PARTS, Estimate, Findings, Plot, jackknife, unknown
from turtlebag.sim.robots import Limits

Commands = tuple[Stamps, Array, Array]
"""Times (n,) [ns], forward [m/s] and turning speeds [rad/s]."""
EQUATION = "speed(t + dt) = speed(t) + clip(command(t - delay) - speed(t), +-acceleration dt)"
# Delays that are tried; below zero, too, for those that look like none.
DELAY_STEP_S = 0.01
DELAYS_S = np.arange(-0.1, 0.605, DELAY_STEP_S)
# Accelerations that are tried, first those from 0.05 to 20 times the usual one and then those up to this
# factor beside the best; one is known to no better than such a share.
STEPS, NEAR = 28, 1.5
FLOORS = {"max_dv": 0.006, "max_dw": 0.008}
# Commands that change by this share of the largest count as changes; so many are needed.
CHANGE, ENOUGH = 0.1, 5


def motor_findings(recording: Recording, commands: Commands | None, limits: Limits) -> Findings:
    """Delay of the commands [s] and accelerations [m/s^2, rad/s^2]."""
    found = Findings()
    kinds = ("max_dv", "m/s^2", limits.max_dv), ("max_dw", "rad/s^2", limits.max_dw)
    path = recording.odometry
    if commands is None or path is None or len(path) < 100:
        why = "no /cmd_vel" if commands is None else "no odometry between scans"
        found.estimates.append(unknown("command_delay", limits.command_delay, "s", EQUATION, why))
        found.estimates += [unknown(name, value, unit, EQUATION, why) for name, unit, value in kinds]
        return found
    times, dt, speeds = _speeds(recording)
    parts, wanted = [], []
    for (_, _, usual), speed, told in zip(kinds, speeds, commands[1:], strict=True):
        after = usual * np.geomspace(0.05, 20.0, STEPS)
        asked = _asked(commands[0], told, recording, times)
        wanted.append((after, asked))
        parts.append(_costs(speed, asked, after, dt))
    changes = [_changes(told) for told in commands[1:]]
    _delay(parts, changes, float(np.median(dt)), limits, found)
    best = int(np.argmin(sum(part.sum(axis=0).min(axis=1) for part in parts)))
    for k, (kind, often) in enumerate(zip(kinds, changes, strict=True)):
        after, asked = wanted[k]
        rough = parts[k][:, best].sum(axis=0)
        near = after[np.argmin(rough)] * np.geomspace(1.0 / NEAR, NEAR, STEPS)
        fine = _lag_costs(speeds[k], asked[best], near, dt)
        _acceleration(kind, rough[-1], fine, near, often, found)
    which = int(changes[1] > changes[0])
    first = int(np.argmax(np.abs(np.diff(wanted[which][1][best], prepend=0.0)) > 0.0)) if len(dt) else 0
    some = slice(max(first - 30, 0), first + 300)
    found.plots["command"] = Plot(
        ("command_delay", "max_dv", "max_dw"), "Commands and speed",
        "Ten seconds: the speed by odometry follows the command, as late as it is.",
        "time [s]", ("forward [m/s]", "turning [rad/s]")[which], {},
        {"command": (times[some] - times[0], wanted[which][1][0][some]),
         "odometry": (times[some] - times[0], speeds[which][some])},
    )  # fmt: skip
    return found


def _speeds(recording: Recording) -> tuple[Array, Array, tuple[Array, Array]]:
    """Beginnings (n,) and lengths [s] of the odometry's steps, and its forward and turning speeds in them."""
    path = recording.odometry
    assert path is not None
    times = seconds(path.stamps_ns - path.stamps_ns[0])
    dt = np.diff(times)
    ok = (dt > 1e-4) & (dt < 1.0)
    steps = path.poses.steps()
    x, y, turn = steps[ok].T
    forward = x * np.cos(0.5 * turn) + y * np.sin(0.5 * turn)
    return times[:-1][ok], dt[ok], (forward / dt[ok], turn / dt[ok])


def _asked(stamps_ns: Stamps, told: Array, recording: Recording, times: Array) -> Array:
    """The command that holds at each time less each delay, (delays, n)."""
    assert recording.odometry is not None
    order = np.argsort(stamps_ns, kind="stable")
    at = seconds(stamps_ns[order] - recording.odometry.stamps_ns[0])
    # half a millisecond: stamps in nanoseconds are rounded
    k = np.searchsorted(at, times[None] - DELAYS_S[:, None] + 5e-4, side="right") - 1
    return np.where(k >= 0, told[order][np.maximum(k, 0)], 0.0)


def _costs(speed: Array, asked: Array, after: Array, dt: Array) -> Array:
    """Squared differences of the speed (n,) from what each delay and acceleration makes of the commands,
    summed in each part of the drive, (PARTS, delays, accelerations), over the speed's mean square."""
    value, asked = np.zeros((len(asked), len(after))), _within_limits(asked, speed)
    out = np.zeros((PARTS, *value.shape))
    for k in range(len(dt)):
        step = after * dt[k]
        value += np.clip(asked[:, k, None] - value, -step, step)
        out[k * PARTS // len(dt)] += (value - speed[k]) ** 2
    return out / max(float(np.mean(speed**2)), 1e-9)


def _lag_costs(speed: Array, asked: Array, after: Array, dt: Array) -> Array:
    """The same (PARTS, accelerations) at one delay, where a share of each step comes a step late, as motors
    have it: the share that fits best."""
    model, asked = np.zeros((len(dt) + 1, len(after))), _within_limits(asked, speed)
    for k in range(len(dt)):
        model[k + 1] = model[k] + np.clip(asked[k] - model[k], -after * dt[k], after * dt[k])
    off, back = model[1:] - speed[:, None], model[:-1] - model[1:]
    share = -(off * back).sum(axis=0) / np.maximum((back**2).sum(axis=0), 1e-12)
    cost = (off + np.clip(share, 0.0, 1.0) * back) ** 2
    part = np.arange(len(dt)) * PARTS // len(dt)
    sums = np.array([cost[part == k].sum(axis=0) for k in range(PARTS)])
    return sums / max(float(np.mean(speed**2)), 1e-9)


def _within_limits(asked: Array, speed: Array) -> Array:
    """Commands within the limits of speed: what the robot never goes beyond."""
    most = float(np.quantile(np.abs(speed), 0.999)) + 1e-3
    return np.clip(asked, -most, most)


def _changes(told: Array) -> int:
    most = float(np.abs(told).max(initial=0.0))
    return int(np.count_nonzero(np.abs(np.diff(told)) > CHANGE * most)) if most > 0.0 else 0


def _delay(parts: list[Array], changes: list[int], every_s: float, limits: Limits, found: Findings) -> None:
    if max(changes) < ENOUGH:
        found.estimates.append(
            unknown("command_delay", limits.command_delay, "s", EQUATION, "the commands hardly change")
        )
        return
    both = parts[0].min(axis=2) + parts[1].min(axis=2)
    values, covariance, freedom = jackknife(both, lambda cost: np.array([_middle(cost)[0]]))
    # a step has the command that held at its beginning, though half of it may go by before the next acts
    value = max(float(values[0]) + 0.5 * every_s, 0.0)
    # between two commands or two readings of the speed, any delay is as good
    width = max(_middle(both.sum(axis=0))[1], every_s)
    sigma = float(np.hypot(covariance[0, 0] ** 0.5, 0.6 * width / 1.96))
    found.estimates.append(Estimate("command_delay", value, sigma, "s", EQUATION, "", freedom, True))


def _middle(cost: Array) -> tuple[float, float]:
    """The middle and the width of the delays [s] that explain the speeds as well as the best one does."""
    good = np.flatnonzero(cost <= cost.min() * 1.02 + 1e-9)
    return float(DELAYS_S[good].mean()), float(DELAYS_S[good[-1]] - DELAYS_S[good[0]]) + DELAY_STEP_S


def _acceleration(
    kind: tuple[str, str, float], at_once: float, part: Array, after: Array, often: int, found: Findings
) -> None:
    """One of the accelerations by the costs of those `after` which the speed changes, (PARTS, n), and by that
    of a speed that changes at once."""
    name, unit, usual = kind

    def fitted(cost: Array) -> Array:
        k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
        a, b, c = cost[k - 1], cost[k], cost[k + 1]
        bend = a - 2.0 * b + c
        aside = 0.5 * (a - c) / bend if bend > 0.0 else 0.0
        return np.array([np.log(after[k]) + np.clip(aside, -1.0, 1.0) * np.log(after[1] / after[0])])

    values, covariance, freedom = jackknife(part, fitted)
    limited = at_once > 1.3 * part.sum(axis=0).min()
    sigma = float(np.hypot(covariance[0, 0] ** 0.5, FLOORS[name]))
    why = (
        "the commands hardly change" if often < ENOUGH
        else "the speeds follow the commands at once" if not limited
        else "not the same in all of the drive" if sigma > 0.5
        else ""
    )  # fmt: skip
    value = float(np.exp(values[0]))
    found.estimates.append(
        unknown(name, usual, unit, EQUATION, why)
        if why
        else Estimate(name, value, sigma * value, unit, EQUATION, "", freedom, True)
    )
