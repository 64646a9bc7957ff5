"""Odometry calibration by the scans: systematic errors of the wheels, and the remaining noise.

Wheel radius and separation are never exactly as configured, so odometry is wrong by nearly constant shares
(Censi et al. 2013), which scans measure; where these are blind, as in a bare corridor, only odometry is left,
and 1 % of wheel radius is 10 cm on 10 m.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.robust import cauchy_weight, sigma_by_median
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.pose_graph import chain, positive_definite
from turtlebag.pipeline.slam.scans.align import match_information
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits
from turtlebag.pipeline.slam.scans.pairs import match_pairs

# Key scans are compared over a baseline, this much driving [m] or a radian of turning: far enough for scale
# errors to exceed the noise of a match, near enough for the views to overlap.
BASELINE_M = 1.5
# Error of the odometry before calibration: share of distance and of turn, radian per metre.
ODOMETRY_SHARE = 0.05
# Odometry with a larger relative error than this is wrong, not late: the error of wheels with a late clock
# stays below it whenever the robot starts.
GROSS = 0.3
# Standard deviations over one baseline before calibration, x, y [m] and yaw [rad], and the smallest ones
# assumed; this many pairs of key scans weigh as much as the former.
USUAL_NOISE = np.array([0.03, 0.03, 0.015])
LEAST_NOISE = 0.1 * USUAL_NOISE
ENOUGH = 30.0


@dataclass(frozen=True)
class Calibration:
    """True step = scale x distance, turn_scale x turn + turn_per_m x distance [rad/m].

    `noise` are standard deviations (x, y [m], yaw [rad]) of what is left over one baseline of driving;
    `pairs` is how many pairs of key scans agreed on it; `covariance` (3, 3) is that of the three shares.
    """

    scale: float = 1.0
    turn_scale: float = 1.0
    turn_per_m: float = 0.0
    noise: Array = field(default_factory=lambda: USUAL_NOISE)
    pairs: int = 0
    covariance: Array = field(default_factory=lambda: ODOMETRY_SHARE**2 * np.eye(3))

    def corrected(self, steps: Array) -> Array:
        """Odometry steps (..., 3) with the systematic error taken out."""
        out = np.array(steps, dtype=np.float64)
        out[..., :2] *= self.scale
        # signed by the direction driven: backing up undoes what driving forward did
        out[..., 2] = self.turn_scale * steps[..., 2] + self.turn_per_m * steps[..., 0]
        return out

    def information(self, steps: Array) -> Array:
        """Information (..., 3, 3) of corrected steps (..., 3), errors growing as a random walk."""
        sigma = self.noise * np.sqrt(baselines(steps))[..., None] + 0.3 * LEAST_NOISE
        return np.eye(3) * sigma[..., None, :] ** -2.0


def gross(error: Array | float, size: Array | float) -> NDArray[np.bool_]:
    """Whether odometry with such errors (n,) of motions of such a size (n,) is wrong, not just late."""
    return np.abs(error) > GROSS * np.asarray(size)


def calibrate(clouds: Clouds, keys: NDArray[np.int64], T_map_keys: SE2, T_odom_keys: SE2) -> Calibration:
    """Systematic errors of odometry, from key scans matched with each other without its help.

    `T_map_keys` (n,) only start the matches. Each pair counts in the directions its scans observe; stretches
    of wrong odometry are down-weighted (Cauchy kernel).
    """
    steps = T_odom_keys.steps()
    pairs, matched, information = matched_pairs(clouds, keys, T_map_keys, steps)
    return fit_shares(steps, pairs, matched, information) if len(pairs) else Calibration()


def baselines(steps: Array) -> Array:
    """Length of steps (..., 3) in baselines, (...,)."""
    return np.hypot(steps[..., 0], steps[..., 1]) / BASELINE_M + np.abs(steps[..., 2])


def baseline_pairs(steps: Array) -> NDArray[np.int64]:
    """Each key with the first one at least a baseline later, (n, 2)."""
    path = np.concatenate([[0.0], np.cumsum(baselines(steps))])
    j = np.searchsorted(path, path + 1.0)
    i = np.flatnonzero(j < len(path))
    return np.stack([i, j[i]], axis=1)


def matched_pairs(
    clouds: Clouds, keys: NDArray[np.int64], T_map_keys: SE2, steps: Array
) -> tuple[NDArray[np.int64], Array, Array]:
    """Pairs (n, 2) of keys a baseline apart whose two scans match; T_i_j (n, 3), information (n, 3, 3)."""
    if not len(pairs := baseline_pairs(steps)):
        return pairs, np.zeros((0, 3)), np.zeros((0, 3, 3))
    i, j = pairs[:, 0], pairs[:, 1]
    T_i_j = (T_map_keys[i].inverse() @ T_map_keys[j]).xyt
    # every pair gets its own key scans, so that each moves on by its own match
    own_keys, own_pairs = keys[pairs].ravel(), np.arange(2 * len(pairs)).reshape(-1, 2)
    fine = Limits.fine()
    for limits in (fine._replace(gate=Limits.rough().gate), fine, fine):
        poses = np.zeros((2 * len(pairs), 3))
        poses[1::2] = T_i_j
        found = match_pairs(clouds, own_keys, SE2(poses), own_pairs, limits)
        T_i_j = found.T_i_j
    good = found.possible
    return pairs[good], T_i_j[good], match_information(found.information[good])


def fit_shares(steps: Array, pairs: NDArray[np.int64], matched: Array, information: Array) -> Calibration:
    """The three errors of the odometry by the motions (n, 3) that the scans show over `pairs`."""
    odometry, prior = chain(steps, pairs), ODOMETRY_SHARE**-2 * np.eye(3)
    error = (SE2(odometry).inverse() @ SE2(matched)).xyt
    shares = fit(error, shares_jacobian(steps, pairs, odometry), information, prior)
    scale, turn_scale, turn_per_m = (shares.values + np.array([1.0, 1.0, 0.0])).tolist()
    used = int(np.count_nonzero(shares.trust > 0.5))
    return Calibration(scale, turn_scale, turn_per_m, shares.noise, used, shares.covariance)


class Fit(NamedTuple):
    """Parameters (p,), covariance, noise left (3,), each pair's weight (n,) and part of the gradient."""

    values: Array
    covariance: Array
    noise: Array
    trust: Array
    scores: Array


def fit(error: Array, jacobian: Array, information: Array, prior: Array) -> Fit:
    """Parameters (p,) that explain errors (n, 3) of pairs, by ridge regression, iteratively reweighted; noise
    from the residuals, then twice more with it. `prior` (p, p) is an information."""
    noise, values = USUAL_NOISE, np.zeros(len(prior))
    for _ in range(3):
        weight = joint_information(information, noise)
        pull = jacobian.transpose(0, 2, 1) @ weight
        of_pairs, towards = pull @ jacobian, np.einsum("nai,ni->na", pull, error)
        for _ in range(8):
            left = error - jacobian @ values
            trust = cauchy_weight(np.einsum("ni,nij,nj->n", left, weight, left))
            a = np.einsum("n,nab->ab", trust, of_pairs) + prior
            values = np.linalg.solve(a, trust @ towards)
        noise = noise_left(left, information)
    scores = trust[:, None] * np.einsum("nai,ni->na", pull, left)
    return Fit(values, np.asarray(np.linalg.inv(a)), noise, trust, scores)


def joint_information(information: Array, noise: Array) -> Array:
    """Information of a match seen through odometry's noise: (H^-1 + S)^-1, H may be singular."""
    inverse = np.diag(noise**-2.0)
    return information @ np.linalg.solve(information + inverse, np.broadcast_to(inverse, information.shape))


def noise_left(left: Array, information: Array) -> Array:
    """Standard deviations by the median of the residuals, pulled to the usual ones if there are few pairs."""
    variance = np.diagonal(np.linalg.inv(positive_definite(information)), axis1=1, axis2=2)
    sees = variance < 4.0 * USUAL_NOISE**2
    out = USUAL_NOISE.copy()
    for k in range(3):
        n = np.count_nonzero(sees[:, k])
        if n > 0:
            measured = sigma_by_median(left[sees[:, k], k])
            share = n / (n + ENOUGH)
            out[k] = max(share * measured + (1.0 - share) * USUAL_NOISE[k], LEAST_NOISE[k])
    return out


def shares_jacobian(steps: Array, pairs: NDArray[np.int64], odometry: Array) -> Array:
    """Effect of each error on a pair's end pose, (n, 3, 3), by finite differences."""
    h = 1e-4
    out = np.zeros((len(pairs), 3, 3))
    for k, moved in enumerate((Calibration(1.0 + h), Calibration(1.0, 1.0 + h), Calibration(1.0, 1.0, h))):
        end = chain(moved.corrected(steps), pairs)
        out[:, :, k] = (SE2(odometry).inverse() @ SE2(end)).xyt / h
    return out
