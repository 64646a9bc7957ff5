"""The sensor set-up as one estimate: wheels, gyro, and where the lidar sits on the robot (Censi et al. 2013).

Over a baseline of driving, scans show the motion of the lidar, X^-1 T X, and wheels that of the base, T; X is
the lidar's pose on the base. Turns show where the lidar sits and the scale of the turns; ways, its direction
and the scale of the wheels: one least squares gives all, with a covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.lidars import of_each_lidar
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.sensor_times import Estimate
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.graph.pose_graph import chain, positive_definite
from turtlebag.pipeline.slam.odometry.calibration import (
    Calibration,
    Fit,
    fit,
    matched_pairs,
)
from turtlebag.pipeline.slam.scans.clouds import KeyScans
from turtlebag.pipeline.slam.sensors.gyro_slip import GyroTurns
from turtlebag.pipeline.slam.times.stretches import usual_period

# What is estimated of wheels and lidar, and of a gyro: name, unit, and standard deviation a priori.
WHEELS_LIDAR = (
    ("wheel_scale", "1", 0.05), ("turn_scale", "1", 0.05), ("turn_per_m", "rad/m", 0.05),
    ("lidar_x", "m", 0.1), ("lidar_y", "m", 0.1), ("lidar_yaw", "rad", 0.1),
)  # fmt: skip
GYRO = (("gyro_scale", "1", 0.05), ("gyro_bias", "rad/s", 0.01))
# No estimate is better than this, in its unit: matches have small errors in common.
LEAST_SIGMA = 5e-4
# A drive shows what it makes known at least this many times better than it is a priori.
BETTER = 2.0
# The lidar's pose is wrong if its error is this many standard deviations, and no more a priori.
SIGNIFICANT, POSSIBLE = 5.0, 3.0
# The equations are solved this many times, each time about the last solution.
ROUNDS = 3


PoseError = tuple[float, float, float]


@dataclass(frozen=True)
class Quantity:
    """A number of the set-up: its value and standard deviation in `unit`, whether the drive shows it at all
    (else it is what was assumed), and what the recording says, if it says anything."""

    name: str
    value: float
    sigma: float
    unit: str
    observable: bool
    declared: float | None = None

    @property
    def interval_95(self) -> tuple[float, float]:
        """The interval that holds it with 95 %."""
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma

    def as_metrics(self) -> dict[str, Any]:
        """Its entry in metrics.json."""
        said = {} if self.declared is None else {"declared": self.declared}
        interval = {"value": self.value, "interval_95": list(self.interval_95)}
        return {**interval, "unit": self.unit, "observable": self.observable, **said}


@dataclass(frozen=True)
class SensorSetup:
    """The estimated set-up; `lidar_error` (3,) is how far the lidar is from where the recording that was
    mapped has it, x, y [m] and yaw, if that is significant and possible; `others` are those of further
    lidars."""

    quantities: tuple[Quantity, ...] = ()
    lidar_error: PoseError | None = None
    others: tuple[PoseError | None, ...] = ()

    def __getitem__(self, name: str) -> Quantity:
        return next(one for one in self.quantities if one.name == name)

    def as_metrics(self) -> dict[str, Any]:
        """`sensors` of metrics.json; empty if nothing was compared."""
        of_each = {one.name: one.as_metrics() for one in self.quantities}
        return {"sensors": of_each} if of_each else {}

    def as_records(self) -> list[dict[str, Any]]:
        """The quantities as plain data, for `of_records`."""
        return [asdict(one) for one in self.quantities]

    @staticmethod
    def of_records(records: list[dict[str, Any]]) -> SensorSetup:
        """The set-up of such data."""
        return SensorSetup(tuple(Quantity(**one) for one in records))

    @property
    def misplaced(self) -> bool:
        """Whether some lidar is not where the recording has it."""
        return any(error is not None for error in (self.lidar_error, *self.others))

    def with_others(self, others: Sequence[SensorSetup]) -> SensorSetup:
        """With the poses of further lidars, by scans of their own: `lidar_x_2` is the second one's x."""
        quantities = [
            replace(one, name=f"{one.name}_{number}")
            for number, setup in enumerate(others, start=2)
            for one in setup.quantities
            if one.name.startswith("lidar_")
        ]
        errors = tuple(setup.lidar_error for setup in others)
        return replace(self, quantities=(*self.quantities, *quantities), others=errors)

    def applied(self, recording: Recording) -> Recording:
        """The recording with its lidars where the estimate has them."""
        errors = iter((self.lidar_error, *self.others))
        return of_each_lidar(recording, lambda part: self._placed(part, next(errors)))

    @staticmethod
    def _placed(recording: Recording, error: PoseError | None) -> Recording:
        if error is None:
            return recording
        x, y, yaw = error
        said = (
            f"the lidar sits {100.0 * x:+.1f} cm (x), {100.0 * y:+.1f} cm (y) and {np.rad2deg(yaw):+.1f} "
            "degrees from the recorded mounting (by the motion of scans and odometry); corrected"
        )
        pose = SE2(recording.T_base_lidar.xyt + error)
        return replace(recording, T_base_lidar=pose, notes=(*recording.notes, said))


def sensor_setup(
    recording: Recording, key_scans: KeyScans, T_track_keys: SE2, T_base_lidar: SE2
) -> SensorSetup:
    """The set-up of a recording with odometry, by its key scans (n,) as the front end placed them.

    `T_base_lidar` is the lidar's pose as declared; that of `recording` may have been corrected since.
    """
    clouds, keys = key_scans
    assert recording.T_odom_base is not None
    steps = recording.T_odom_base[keys].steps()
    pairs, T_i_j, information = matched_pairs(clouds, keys, T_track_keys, steps)
    if not len(pairs):
        return SensorSetup()
    matched = SE2(T_i_j)
    values, covariance = _wheels_and_lidar(steps, pairs, matched, information, recording.T_base_lidar)
    current = np.array([1.0, 1.0, 0.0, *recording.T_base_lidar.xyt])
    declared = [1.0, 1.0, 0.0, *T_base_lidar.xyt.tolist()]
    quantities = _named(WHEELS_LIDAR, current + values, covariance, declared)
    if recording.imu is not None:
        turns, known = GyroTurns(recording.imu).turns(recording.stamps_ns[keys])
        times = seconds(recording.stamps_ns[keys] - recording.stamps_ns[keys[0]])
        quantities += _gyro(turns, known, times, pairs, matched.yaw, information)
    quantities += _times(recording)
    return SensorSetup(quantities, _wrong_pose(values[3:], covariance[3:, 3:]))


def _times(recording: Recording) -> tuple[Quantity, ...]:
    """When odometry and lidar measured; what was assumed where the drive does not show it."""
    times, lidar = recording.times, recording.lidar
    sweep = lidar.time_increment * lidar.n_beams / usual_period(recording)
    known = [
        ("odometry_delay", times.delay_s, "s", Estimate(0.0, 0.2)),
        ("sweep", times.sweep, "periods", Estimate(sweep, 0.5)),
        ("first_beam", times.first_beam, "1", Estimate(0.0, 0.25 * lidar.n_beams)),
    ]
    return tuple(
        Quantity(name, (one or assumed).value, (one or assumed).sigma, unit, one is not None)
        for name, one, unit, assumed in known
    )


def _wheels_and_lidar(
    steps: Array, pairs: NDArray[np.int64], matched: SE2, information: Array, T_base_lidar: SE2
) -> tuple[Array, Array]:
    """Errors of the wheels and of the lidar's pose (6,), and their covariance (6, 6)."""
    values, prior, little = np.zeros(6), _prior(WHEELS_LIDAR), 1e-4 * np.eye(6)
    for _ in range(ROUNDS):
        expected = _expected(values, steps, pairs, T_base_lidar).inverse()
        columns = [(expected @ _expected(values + h, steps, pairs, T_base_lidar)).xyt for h in little]
        jacobian = np.stack(columns, axis=2) / 1e-4
        # about zero, where the prior is
        error = (expected @ matched).xyt + jacobian @ values
        solution = fit(error, jacobian, information, prior)
        values = solution.values
    return values, _covariance(solution, pairs, prior)


def _expected(values: Array, steps: Array, pairs: NDArray[np.int64], T_base_lidar: SE2) -> SE2:
    """The motions (n,) over pairs that scans show whose lidar is taken to sit as declared."""
    by_wheels = Calibration(1.0 + values[0], 1.0 + values[1], values[2]).corrected(steps)
    # a step that turns more than the wheels say leads aside by half of the difference
    half = 0.5 * (by_wheels[:, 2] - steps[:, 2])
    ahead = by_wheels[:, 0] + 1j * by_wheels[:, 1]
    ahead = ahead * np.exp(1j * half)
    by_wheels[:, 0], by_wheels[:, 1] = ahead.real, ahead.imag
    moved = SE2(T_base_lidar.xyt + values[3:]) @ T_base_lidar.inverse()
    return moved.inverse() @ SE2(chain(by_wheels, pairs)) @ moved


def _gyro(
    turns: Array,
    known: NDArray[np.bool_],
    times: Array,
    pairs: NDArray[np.int64],
    matched_yaw: Array,
    information: Array,
) -> tuple[Quantity, ...]:
    """Scale and bias of a gyro: a turn is `scale * (turn by the gyro - bias * time)`."""
    unknown = np.append(0, np.cumsum(~known))
    whole = unknown[pairs[:, 1]] == unknown[pairs[:, 0]]
    if not whole.any():
        return ()
    pairs, matched_yaw, information = pairs[whole], matched_yaw[whole], information[whole]
    so_far = np.append(0.0, np.cumsum(turns))
    by_gyro, waited = so_far[pairs[:, 1]] - so_far[pairs[:, 0]], times[pairs[:, 1]] - times[pairs[:, 0]]
    # one that is mounted upside down turns the other way
    sign = 1.0 if by_gyro @ matched_yaw >= 0.0 else -1.0
    error, jacobian = np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3, 2))
    error[:, 2] = wrap(matched_yaw - sign * by_gyro)
    jacobian[:, 2, 0], jacobian[:, 2, 1] = sign * by_gyro, -sign * waited
    of_yaw = np.zeros_like(information)
    of_yaw[:, 2, 2] = 1.0 / np.linalg.inv(positive_definite(information))[:, 2, 2]
    prior = _prior(GYRO)
    solution = fit(error, jacobian, of_yaw, prior)
    values = np.array([1.0, 0.0]) + solution.values
    return _named(GYRO, values, _covariance(solution, pairs, prior), [1.0, None])


def _prior(of: tuple[tuple[str, str, float], ...]) -> Array:
    return np.diag([sigma**-2.0 for _, _, sigma in of])


def _covariance(solution: Fit, pairs: NDArray[np.int64], prior: Array) -> Array:
    """Covariance by how much what the pairs say differs: the sandwich of Huber (1967), for pairs that share
    stretches of the drive (Newey and West 1987)."""
    scores, trust = solution.scores, solution.trust
    shared = 2 * max(1, round(float(np.median(pairs[:, 1] - pairs[:, 0]))))
    spread = scores.T @ scores
    for k in range(1, min(shared + 1, len(pairs))):
        both = scores[k:].T @ scores[:-k]
        spread += (1.0 - k / (shared + 1)) * (both + both.T)
    # Cauchy's kernel flattens out: a residual moves its score less than its weight says
    steep = (trust * (1.0 + 2.0 * trust)).sum() / (3.0 * trust.sum())
    of_data = solution.covariance @ (spread + prior) @ solution.covariance / steep**2
    return np.asarray(of_data + LEAST_SIGMA**2 * np.eye(len(prior)))


def _named(
    of: tuple[tuple[str, str, float], ...], values: Array, covariance: Array, declared: list[float | None]
) -> tuple[Quantity, ...]:
    sigmas = np.sqrt(np.diag(covariance)).tolist()
    return tuple(
        Quantity(name, value, sigma, unit, BETTER * sigma < usual, said)
        for (name, unit, usual), value, sigma, said in zip(of, values.tolist(), sigmas, declared, strict=True)
    )


def _wrong_pose(error: Array, covariance: Array) -> PoseError | None:
    """The error of the lidar's pose (3,) if it is significant and possible."""
    significant = error @ np.linalg.solve(covariance, error) > SIGNIFICANT**2
    usual = np.array([sigma for _, _, sigma in WHEELS_LIDAR[3:]])
    if not significant or (np.abs(error) > POSSIBLE * usual).any():
        return None
    x, y, yaw = error.tolist()
    return x, y, yaw
