"""A reference and an estimate in space, by formula: the same numbers on every machine."""

import numpy as np

from turtlebag.datasets.se3 import exp
from turtlebag.datasets.trajectories_3d import Trajectory3D


def reference(n=120, step_s=0.2):
    """A rolling, pitching loop of some 20 m with a climb."""
    t = np.linspace(0.0, 2.0 * np.pi, n)
    xi = np.stack([0.1 * np.sin(3 * t), 0.05 * np.cos(2 * t), 0.9 * np.sin(t), 0 * t, 0 * t, 0 * t], axis=1)
    T = exp(xi)
    T[:, :3, 3] = np.stack([4.0 * np.cos(t), 2.5 * np.sin(t), 0.3 * np.sin(2 * t)], axis=1)
    return Trajectory3D(1_700_000_000_000_000_000 + np.arange(n, dtype=np.int64) * round(step_s * 1e9), T)


def estimate():
    """The same in another frame, wobbling, without every seventh pose, stamps up to 4 ms off."""
    truth = reference()
    k = np.arange(len(truth))
    wobble = 0.02 * np.stack([np.sin((c + 1.3) * k) for c in range(6)], axis=1)
    frame = exp(np.array([0.02, -0.03, 1.1, 3.0, -2.0, 0.5]))
    stamps = truth.stamps_ns + np.rint(4e6 * np.sin(2.1 * k)).astype(np.int64)
    return Trajectory3D(stamps, frame @ truth.T @ exp(wobble))[k % 7 != 3]
