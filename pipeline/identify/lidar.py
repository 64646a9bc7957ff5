"""The lidar's own errors, by what neighbouring beams and successive turns of it say of each other.

In polar coordinates a wall's u = 1 / r is a cosine of the bearing, so of beams on one wall two tell what a
third should be, wherever the robot is: how far it is off is noise, and that it is not there is a lost beam.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import without_gap
from turtlebag.datasets.robust import PER_MEDIAN
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.identify.estimates import PARTS, Estimate, Findings, Plot, jackknife, unknown
from turtlebag.pipeline.identify.random_walk import RandomWalk
from turtlebag.sim.robots import LidarErrors

# Times between stamps that vary by less [s] are exact; a variance shows if its logarithm is known to within
# this.
EXACT_S, KNOWN = 1e-5, 1.0
# Scans that are looked at; beams that count for a bin; the least share by which bins of ranges differ.
SCANS, ENOUGH, FACTOR = 1500, 60, 1.25
# Beams are on one wall if those around agree as well as this many of their usual differences.
ON_ONE_WALL = 3.0
# Beams graze a wall at cosines of less than this; how many are lost there is known no better than this.
GRAZED, LEAST_GRAZING = 0.1, 0.002
# Walls are met across at cosines of more than this; directions of beams may be off by this [rad].
ACROSS, ASIDE_RAD = 0.7, 0.002
# Not all that looks like a wall is one: by so large a share each number may be wrong for it.
MODEL, LOST_MODEL = np.array([0.003, 0.0075, 0.015]), np.array([0.02, 0.0025])
# The same of the logarithms of both variances of stamps. Delays are uniform, and their variance is known by a
# smaller variance than that of Gaussian ones, (1.8 - 1) / (3 - 1) by their kurtosis.
STAMPS_MODEL, STAMPS_SHAPE = np.array([0.12, 0.02]), np.array([1.0, 0.4**0.5])
# Variance of a unit Gaussian that is cut at three standard deviations; units of the file by those of the fit.
TRUNCATED, TO_FIT = 0.97334, np.array([1.0, 1.0, np.rad2deg(1.0)])
# Steps of the readings that are looked for [m].
STEPS_M = (0.05, 0.04, 0.025, 0.02, 0.01, 0.005, 0.004, 0.0025, 0.002, 0.001, 0.0005, 0.00025)
NOISE_EQUATION = "var(r) = sigma^2 + (sigma_square r^2)^2 + (angle r tan(i))^2 + resolution^2 / 12"
LOST_EQUATION = "P(return) = (1 - lost) (1 - exp(-cos(i) / grazing)), i from the surface's normal"
STAMPS_EQUATION = "d_k = P (1 + jitter) + late_k+1 - late_k; cov(d_k, d_k+1) = -var(late)"


class Walls(NamedTuple):
    """Beams (m,) on straight walls, as their neighbours say: number of the scan, expected range [m], cosine
    of the incidence, and whether it is lost. `off` is a second difference of three neighbours in ranges [m],
    whose standard deviation is that of a reading; NaN where a reading is missing."""

    scan: NDArray[np.int64]
    expected: Array
    cosine: Array
    off: Array
    lost: NDArray[np.bool_]


def walls_of(recording: Recording) -> Walls:
    """The beams on walls of some scans of a lidar."""
    step = max(1, len(recording) // SCANS)
    lidar, d = recording.lidar, recording.stride
    ranges = recording.ranges[::step].astype(np.float64)
    back = lidar.returns(recording.ranges[::step])
    u = np.where(back, 1.0 / np.where(back, ranges, 1.0), np.nan)
    turn = abs(d * lidar.angle_increment)

    n = u.shape[1] - 8 * d
    if n < 8:
        none = np.zeros(0)
        return Walls(np.zeros(0, np.int64), none, none, none, np.zeros(0, bool))
    at = {k: u[:, (4 + k) * d : (4 + k) * d + n] for k in range(-4, 5)}
    # u = a cos(k turn) + b sin(k turn), from the beams at 2 and 4 beside
    near = (at[-2] + at[2]) / (2.0 * np.cos(2 * turn))
    far = (at[-4] + at[4]) / (2.0 * np.cos(4 * turn))
    slopes = [(at[k] - at[-k]) / (2.0 * np.sin(k * turn)) for k in (2, 4)]
    slope = 0.5 * (slopes[0] + slopes[1])
    middle = 0.5 * (near + far)
    known = np.isfinite(near) & np.isfinite(far) & (middle > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        r = 1.0 / middle
        skew = np.sin(2 * turn) * np.abs(slopes[0] - slopes[1])
        bent = np.maximum(np.abs(near - far), skew) / middle**2
        cosine = middle / np.hypot(middle, slope)
        off = (
            (at[-1] + at[1] - 2.0 * np.cos(turn) * at[0]) / middle**2 / np.sqrt(2.0 + 4.0 * np.cos(turn) ** 2)
        )
        silent = (lidar.silent(recording.ranges[::step]) | np.isnan(ranges))[:, 4 * d : 4 * d + n]
        # what is nearer than the lidar measures, or not as far as it can, is not lost
        known &= (r > 1.05 * lidar.range_min) & (r < 0.95 * lidar.range_max)
    scan, beam = np.nonzero(known)
    straight = bent[known] < ON_ONE_WALL * _usual(bent[known], r[known], cosine[known])
    rows = scan[straight], beam[straight]
    lost = silent[rows] & ~np.isfinite(at[0][rows])
    return Walls(rows[0] * step, r[rows], cosine[rows], off[rows], lost)


def _usual(bent: Array, r: Array, cosine: Array) -> Array:
    """How much the beams (m,) of one wall usually differ [m]: as those that meet it across, and as directions
    that are off make it more on slanting walls, where most neighbours are of no wall at all."""
    kind = np.floor(np.log(r) / np.log(FACTOR)).astype(int)
    kind -= kind.min(initial=0)
    across, usual = cosine > ACROSS, np.full(kind.max(initial=0) + 1, np.nan)
    for k in np.unique(kind[across]):
        usual[k] = PER_MEDIAN * np.median(bent[across][kind[across] == k])
    return np.hypot(
        np.maximum(usual[kind], 1e-4), r * ASIDE_RAD * np.sqrt(np.maximum(cosine**-2.0 - 1.0, 0.0))
    )


def lidar_findings(recording: Recording, base: LidarErrors) -> Findings:
    """All of the lidar's errors that its own readings show."""
    found, walls = Findings(), walls_of(recording)
    part = (walls.scan * PARTS) // max(len(recording), 1)
    step = resolution_of(recording)
    found.estimates.append(
        Estimate("resolution", step, 0.0, "m", "largest step of which all readings are whole multiples")
    )
    _noise(walls, part, step, base, found)
    _lost(walls, part, base, found)
    _turns(recording, base, found)
    return found


def resolution_of(recording: Recording) -> float:
    """The step of the readings [m], 0 if none shows."""
    some = recording.ranges[:: max(1, len(recording) // 50)]
    r = some[recording.lidar.returns(some)].astype(np.float64)
    for step in STEPS_M:
        if (
            len(r) > ENOUGH
            and np.quantile(np.abs(r / step - np.round(r / step)) * step, 0.98) < 2e-6 + 1e-3 * step
        ):
            return step
    return 0.0


def _noise(walls: Walls, part: NDArray[np.int64], step: float, base: LidarErrors, found: Findings) -> None:
    names = {"sigma": "m", "sigma_square": "1/m", "angle_deg": "deg"}
    tangent = np.sqrt(np.maximum(walls.cosine**-2.0 - 1.0, 0.0))
    good = np.isfinite(walls.off) & (walls.cosine > 0.25)
    r, tan, off, part = walls.expected[good], tangent[good], walls.off[good], part[good]
    if len(r) < 20 * ENOUGH:
        why = "too few straight walls" if len(r) else "no straight walls"
        found.estimates += [unknown(n, getattr(base, n), u, NOISE_EQUATION, why) for n, u in names.items()]
        return
    sums, columns, slant = _noise_bins(r, tan, off, part)
    rounded = step**2 / 12.0

    def fitted(sums: Array) -> Array:
        variance = sums[0] / np.maximum(sums[1], 1.0)
        expected = np.maximum(variance, 1e-9)
        for _ in range(3):  # a bin that has little noise by chance does not count more for it
            weight = np.sqrt(sums[1]) / expected
            parts, _ = scipy.optimize.nnls(columns * weight[:, None], (variance - rounded) * weight)
            expected = np.maximum(columns @ parts + rounded, 1e-9)
        return np.sqrt(parts) * TO_FIT

    values, covariance, freedom = jackknife(sums, fitted)
    covariance = covariance + np.diag(np.square(MODEL * values))
    sigmas = np.sqrt(np.diag(covariance))
    if np.isfinite(sigmas).all():
        found.correlate([*names], covariance)
    whole = sums.sum(axis=0)
    far = float(np.quantile(r, 0.99))
    for (name, unit), value, sigma in zip(names.items(), values.tolist(), sigmas.tolist(), strict=True):
        why = "" if np.isfinite(sigma) else "too short a drive"
        if name == "sigma_square" and value <= 2.0 * sigma:
            why = f"not told from the constant noise within {far:.1f} m"
        if name == "angle_deg" and value <= 2.0 * sigma:
            why = "no more noise on slanting walls than on others"
        if name == "sigma" and value <= 2.0 * sigma:
            why = "less than the other noise"
        found.estimates.append(
            unknown(name, value if np.isfinite(sigma) else getattr(base, name), unit, NOISE_EQUATION, why)
            if why
            else Estimate(name, value, sigma, unit, NOISE_EQUATION, "", freedom, True)
        )
    _plot_noise(whole, columns, slant, np.sqrt(columns @ np.square(values / TO_FIT) + rounded), found)


def _noise_bins(r: Array, tan: Array, off: Array, part: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Sums of squares and counts of differences (m,) in each part, by bins of range and incidence, (PARTS, 2,
    bins); what each kind of noise adds to a bin's variance, (bins, 3); how slanting each bin's walls are."""
    radial = np.floor(np.log(r) / np.log(FACTOR)).astype(int)
    kind = (radial - radial.min()) * 4 + np.digitize(tan, [0.4, 1.0, 2.0])
    kinds = [k for k in np.unique(kind) if np.count_nonzero(kind == k) >= ENOUGH]
    variances, counts = np.zeros((PARTS, len(kinds))), np.zeros((PARTS, len(kinds)))
    centres = np.zeros((len(kinds), 2))
    for column, k in enumerate(kinds):
        own = kind == k
        square = off[own] ** 2
        # readings that are far off are no noise of beams: cut at 3 sigma
        cut = (3.0 * PER_MEDIAN) ** 2 * np.median(square)
        kept = square < cut
        rows = part[own][kept]
        variances[:, column] = np.bincount(rows, square[kept] / TRUNCATED, PARTS)
        counts[:, column] = np.bincount(rows, minlength=PARTS)
        centres[column] = np.mean(r[own] ** 4), np.mean((r[own] * tan[own]) ** 2)
    columns = np.column_stack([np.ones(len(kinds)), centres])
    return np.stack([variances, counts], axis=1), columns, np.array([k % 4 for k in kinds])


def _plot_noise(whole: Array, columns: Array, slant: Array, model: Array, found: Findings) -> None:
    seen, x = np.sqrt(whole[0] / np.maximum(whole[1], 1.0)), columns[:, 1] ** 0.25
    label = ("across", "slanting", "more slanting", "grazing")
    rows = {label[s]: np.flatnonzero(slant == s) for s in range(4) if (slant == s).any()}
    found.plots["noise"] = Plot(
        ("sigma", "sigma_square", "angle_deg"), "Noise of the ranges",
        "Standard deviation of a beam from what its neighbours on one wall say; lines: the fit.",
        "range [m]", "standard deviation [mm]",
        {name: (x[k], 1e3 * seen[k]) for name, k in rows.items()},
        {name: (x[k], 1e3 * model[k]) for name, k in rows.items()},
    )  # fmt: skip


def _lost(walls: Walls, part: NDArray[np.int64], base: LidarErrors, found: Findings) -> None:
    edges = np.concatenate([np.linspace(0.02, 0.3, 15), np.linspace(0.35, 1.0, 8)])
    bins = np.digitize(walls.cosine, edges)
    n_bins = len(edges) + 1
    flat = part * n_bins + bins
    seen = np.bincount(flat, minlength=PARTS * n_bins).reshape(PARTS, n_bins)
    lost = np.bincount(flat, walls.lost, PARTS * n_bins).reshape(PARTS, n_bins)
    centre = np.bincount(bins, walls.cosine, n_bins) / np.maximum(seen.sum(axis=0), 1)
    if seen.sum() < 20 * ENOUGH:
        why = "too few straight walls"
        found.estimates += [
            unknown(n, getattr(base, n), "1", LOST_EQUATION, why) for n in ("lost", "grazing")
        ]
        return

    def fitted(sums: Array) -> Array:
        n, gone = sums

        def cost(p: Array) -> float:
            back = np.clip((1.0 - p[0]) * (1.0 - np.exp(-np.maximum(centre, 1e-3) / p[1])), 1e-9, 1.0 - 1e-9)
            return float(-((n - gone) * np.log(back) + gone * np.log(1.0 - back)).sum())

        share, bounds = gone.sum() / n.sum(), [(0.0, 0.9), (1e-3, 1.0)]
        # far below the usual cosines, grazing has no slope
        ends = [
            scipy.optimize.minimize(cost, [share, grazing], bounds=bounds, method="L-BFGS-B")
            for grazing in (0.02, 0.08, 0.2)
        ]
        return np.asarray(min(ends, key=lambda end: float(end.fun)).x)

    values, covariance, freedom = jackknife(np.stack([seen, lost], axis=1).astype(float), fitted)
    sigmas = np.sqrt(np.diag(covariance))
    whole, gone = seen.sum(axis=0), lost.sum(axis=0)
    # what the counts alone leave open, where no part lost a beam
    sigmas = np.maximum(sigmas, [np.sqrt(max(gone.sum(), 1.0)) / whole.sum(), LEAST_GRAZING])
    sigmas = np.hypot(sigmas, LOST_MODEL * values)
    found.estimates.append(
        Estimate("lost", float(values[0]), float(sigmas[0]), "1", LOST_EQUATION, "", freedom, True)
    )
    # one that hardly loses them is told by many beams that graze and come back
    grazed = seen[:, : len(edges[edges < GRAZED])].sum()
    few = sigmas[1] > (0.3 * values[1] if grazed < ENOUGH else GRAZED)
    found.estimates.append(
        unknown("grazing", base.grazing, "1", LOST_EQUATION, "too few beams met walls at grazing angles")
        if few
        else Estimate("grazing", float(values[1]), float(sigmas[1]), "1", LOST_EQUATION, "", freedom, True)
    )
    ok = whole >= ENOUGH
    angle = np.rad2deg(np.arccos(np.clip(centre, 0.0, 1.0)))
    model = 1.0 - (1.0 - values[0]) * (1.0 - np.exp(-np.maximum(centre, 1e-3) / values[1]))
    found.plots["lost"] = Plot(
        ("lost", "grazing"), "Lost beams by incidence",
        "Share of missing beams between returns of one wall; line: the fit.",
        "angle to the surface's normal [deg]", "lost [%]",
        {"lost": (angle[ok], 100.0 * gone[ok] / whole[ok])}, {"fit": (angle[ok], 100.0 * model[ok])},
    )  # fmt: skip
    _lost_by_range(walls, found)


def _lost_by_range(walls: Walls, found: Findings) -> None:
    bins = np.floor(np.log(walls.expected) / np.log(FACTOR)).astype(int)
    kinds = [k for k in np.unique(bins) if np.count_nonzero(bins == k) >= ENOUGH]
    x = np.array([np.median(walls.expected[bins == k]) for k in kinds])
    y = np.array([100.0 * walls.lost[bins == k].mean() for k in kinds])
    found.plots["lost_by_range"] = Plot(
        (), "Lost beams by range", "Share of beams without a return between returns of one wall.",
        "range [m]", "lost [%]", {"lost": (x, y)},
    )  # fmt: skip


def _turns(recording: Recording, base: LidarErrors, found: Findings) -> None:
    """Period, jitter and late stamps, by the times between stamps."""
    gaps = seconds(np.diff(recording.stamps_ns))
    usual = gaps[without_gap(gaps)]
    period = float(np.median(usual)) if len(usual) else 0.0
    usual = usual[np.abs(usual - period) < 0.3 * period]
    period = float(usual.mean()) if len(usual) else 0.0
    if len(usual) < ENOUGH:
        found.estimates += [
            unknown("rate", 1.0 / period if period else 0.0, "Hz", "1 / mean(d_k)", "too few scans"),
            unknown("jitter", base.jitter, "1", STAMPS_EQUATION, "too few scans"),
            unknown(
                "late_spread",
                base.stamp_delay[1] - base.stamp_delay[0],
                "s",
                STAMPS_EQUATION,
                "too few scans",
            ),
        ]
        return
    found.estimates += _periods(usual, period)
    counts, edges = np.histogram(1e3 * usual, bins=40)
    found.plots["stamps"] = Plot(
        ("rate", "jitter", "late_spread"), "Times between scans",
        "How often each time from one stamp to the next came.",
        "time [ms]", "scans", {"scans": (0.5 * (edges[1:] + edges[:-1]), counts.astype(float))},
    )  # fmt: skip


def _periods(gaps: Array, period: float) -> list[Estimate]:
    """Rate [Hz], jitter and the spread of late stamps [s], end to end, by times between stamps (n,) [s]."""
    if np.std(gaps) < EXACT_S:
        exact = ("rate", 1.0 / period, "Hz"), ("jitter", 0.0, "1"), ("late_spread", 0.0, "s")
        return [Estimate(name, value, 0.0, unit, STAMPS_EQUATION) for name, value, unit in exact]
    ones, good = np.ones((len(gaps) + 1, 1)), np.ones(len(gaps), bool)
    walk = RandomWalk((gaps - period) / period, ones[1:], ones[1:], ones, good)
    (off,), covariance = walk.coefficients()
    rate = 1.0 / (period * (1.0 + float(off)))
    sigma, freedom = rate * float(covariance[0, 0]) ** 0.5, len(gaps)
    found = [Estimate("rate", rate, sigma, "Hz", STAMPS_EQUATION, "", freedom, True)]
    values = np.exp(0.5 * walk.logs) * [1.0, np.sqrt(12.0) * period]
    own = ("jitter", "1"), ("late_spread", "s")
    sure = np.hypot(walk.deviations() * STAMPS_SHAPE, STAMPS_MODEL)
    why = "less than shows beside the stamps' other error"
    for (name, unit), value, of_log in zip(own, values.tolist(), sure.tolist(), strict=True):
        found.append(
            Estimate(name, value, 0.5 * of_log * value, unit, STAMPS_EQUATION, "", np.inf, True)
            if of_log < KNOWN
            else unknown(name, 0.0, unit, STAMPS_EQUATION, why)
        )
    return found
