"""Gaussian mixtures fitted to rasters, and what the fit loses.

The fit maximises the likelihood of the raster's cell masses by expectation maximisation (EM;
Dempster, Laird and Rubin 1977) with the masses as weights. Components are added one at a time, as
in greedy EM (Verbeek, Vlassis and Kröse 2003): each is seeded where the mixture so far explains
too little, in the manner of k-means++ (Arthur and Vassilvitskii 2007).

A cell's mass is the density averaged over the cell. Averaging a Gaussian over a square of side h
gives, to fourth order in h, the Gaussian whose covariance is larger by h^2/12 (Sheppard's
correction). So EM treats the cells as points and fits the averaged mixture, and h^2/12 is taken
off the covariances at the end: the result does not depend on the size of the cells, which lets EM
run on coarse blocks first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wisar_planner.errors import FloatArray, InvalidInput
from wisar_planner.pdm.gaussian_mixture import GaussianMixture
from wisar_planner.pdm.raster_map import RasterMap

TOLERANCE = 0.01
"""Total variation distance that one asks no further component to remove."""

_COARSE_CELLS = 10_000
_FINE_CELLS = 100_000
_CANDIDATES = 6
_TRIAL_ITERATIONS = 5
_ITERATIONS = 60
_FINE_ITERATIONS = 15
_CONVERGED = 1e-6  # nats gained by one iteration


@dataclass(frozen=True)
class MixtureFit:
    """A mixture that stands for a raster, and how well.

    Parameters
    ----------
    mixture : GaussianMixture
        The fit, of the raster normalised to 1, in the raster's metres.
    total_variation : float
        Largest difference between fit and raster in the probability of any set of cells, 0 to 1:
        no path's seen probability is off by more.
    kl_divergence : float
        Kullback-Leibler divergence of the raster from the fit, on cells, in nats.
    top_tenth_share : float
        The raster's mass in the tenth of the cells that the fit holds most probable, as a share
        of its mass in its own most probable tenth: what is lost by searching there first.
    mass_outside : float
        Mass of the fit outside the raster. Gaussians have tails, and nothing cuts them off; a
        search problem counts what lies in its area (p_A).
    criterion : dict of int to float
        Total variation distance on the coarse cells, by number of components tried.
    """

    mixture: GaussianMixture
    total_variation: float
    kl_divergence: float
    top_tenth_share: float
    mass_outside: float
    criterion: dict[int, float]

    @property
    def components(self) -> int:
        """Number of components."""
        return len(self.mixture.weights)

    def __str__(self) -> str:
        """Return the fit in one sentence."""
        return (
            f"{self.components} components, total variation distance {self.total_variation:.3f}, "
            f"KL divergence {self.kl_divergence:.3f} nat, {self.top_tenth_share:.1%} of the mass "
            f"of the most probable tenth, {self.mass_outside:.1%} outside the raster"
        )


def fit_mixture(
    raster: RasterMap,
    *,
    components: int | None = None,
    max_components: int = 16,
    seed: int = 0,
) -> MixtureFit:
    """Fit a Gaussian mixture to a raster.

    Parameters
    ----------
    raster : RasterMap
        The map; its mass is normalised to 1 for the fit.
    components : int, optional
        How many to use. By default the smallest number whose total variation distance is within
        0.01 of the best that any number up to `max_components` reaches. The criterion is the
        error that matters: total variation bounds the error of the seen probability of every
        path. An information criterion would need a sample size, and a raster has none.
    max_components : int
        Largest number to try.
    seed : int
        Of the random seeding; the same seed gives the same fit.

    Returns
    -------
    MixtureFit
        The mixture and its loss against the raster's own cells.

    Raises
    ------
    InvalidInput
        If a number of components is below 1, or asks for more than the raster has cells with
        mass.
    """
    for name, count in (("components", components), ("max_components", max_components)):
        if count is not None and (int(count) != count or count < 1):
            raise InvalidInput(f"{name} must be a whole number of at least 1, not {count}")
    coarse = _Cells.of(raster, _COARSE_CELLS)
    limit = max_components if components is None else components
    # Six numbers per component cannot be told from fewer cells than that.
    most = max(1, len(coarse.mass) // 6)
    if components is not None and components > most:
        raise InvalidInput(
            f"components is {components}, but the raster's cells with mass tell at most {most}"
        )
    fits: list[_Components] = []
    criterion: dict[int, float] = {}
    for fit in _growing_fits(coarse, min(limit, most), np.random.default_rng(seed)):
        fits.append(fit)
        criterion[len(fits)] = coarse.total_variation(fit)
        if components is None and criterion[len(fits)] <= TOLERANCE:
            break
    best = min(criterion.values())
    chosen = components or min(k for k, tv in criterion.items() if tv <= best + TOLERANCE)
    fine = _Cells.of(raster, _FINE_CELLS)
    start = fits[chosen - 1].widened(fine.blur - coarse.blur, fine.floor)
    fit, _ = _maximise(fine, start, _FINE_ITERATIONS)
    return _with_loss(raster, fine.deblurred(fit), criterion)


@dataclass(frozen=True)
class _Components:
    """Weights (K,), means (K, 2) and covariances (K, 2, 2) in the units of some cells."""

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray

    def widened(self, variance: float, floor: float) -> _Components:
        """Return them with a variance added in each direction, none below a floor."""
        covariances = _floored(self.covariances + variance * np.eye(2), floor)
        return _Components(self.weights, self.means, covariances)

    def with_one_more(self, mean: FloatArray, variance: float) -> _Components:
        """Return them with another one of equal share."""
        count = len(self.weights)
        return _Components(
            np.append(self.weights * count, 1.0) / (count + 1),
            np.vstack((self.means, mean)),
            np.concatenate((self.covariances, variance * np.eye(2)[None])),
        )

    def log_coefficients(self) -> FloatArray:
        """Return (K, 6): the log of each weighted Gaussian over (1, x, y, xx, xy, yy)."""
        (a, b), (_, d) = np.moveaxis(self.covariances, 0, -1)
        determinant = a * d - b * b
        pxx, pxy, pyy = d / determinant, -b / determinant, a / determinant
        x, y = self.means.T
        lx, ly = pxx * x + pxy * y, pxy * x + pyy * y
        constant = (
            np.log(self.weights)
            - np.log(2.0 * math.pi * np.sqrt(determinant))
            - 0.5 * (lx * x + ly * y)
        )
        return np.column_stack((constant, lx, ly, -0.5 * pxx, -pxy, -0.5 * pyy))


@dataclass(frozen=True)
class _Cells:
    """The cells of a raster that have mass, as points about their mean in units of their spread.

    A Gaussian's log density is linear in the features (1, x, y, xx, xy, yy) of a point, and its
    moments are sums of them: an EM iteration is two matrix products and an exponential.
    """

    features: FloatArray  # (6, N)
    mass: FloatArray  # (N,), sum 1
    side: float  # of a cell, in units
    own_side: float  # of a cell of the raster itself, in units
    centre: FloatArray  # (2,) m
    unit: float  # m

    @classmethod
    def of(cls, raster: RasterMap, most: int) -> _Cells:
        """Take the raster's cells, summed in square blocks until there are at most `most`."""
        grid, probability = raster.grid, raster.probability
        block = math.ceil(math.sqrt(np.count_nonzero(probability) / most))
        rows, columns = -(-grid.rows // block), -(-grid.columns // block)
        padded = np.zeros((rows * block, columns * block))
        padded[: grid.rows, : grid.columns] = probability
        sums = padded.reshape(rows, block, columns, block).sum(axis=(1, 3))
        row, column = np.nonzero(sums)
        mass = sums[row, column] / sums.sum()
        side = grid.cell * block
        points = np.column_stack((grid.x0 + (column + 0.5) * side, grid.y0 + (row + 0.5) * side))
        centre = mass @ points
        points -= centre
        unit = max(math.sqrt(mass @ (points**2).sum(axis=1) / 2.0), grid.cell)
        x, y = points.T / unit
        features = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y))
        return cls(features, mass, side / unit, grid.cell / unit, centre, unit)

    @property
    def blur(self) -> float:
        """Variance by which averaging over a cell widens a Gaussian, per axis."""
        return self.side**2 / 12.0

    @property
    def floor(self) -> float:
        """Smallest variance: a component as wide as one cell of the raster, blurred."""
        return self.blur + self.own_side**2 / 12.0

    def masses(self, fit: _Components) -> FloatArray:
        """Return the mass (N,) that an averaged mixture puts into each cell."""
        logs = fit.log_coefficients() @ self.features
        return np.exp(logs).sum(axis=0) * self.side**2

    def total_variation(self, fit: _Components) -> float:
        """Return the distance of the fit from the cells; mass of the fit elsewhere counts."""
        return 1.0 - float(np.minimum(self.mass, self.masses(fit)).sum())

    def deblurred(self, fit: _Components) -> GaussianMixture:
        """Return the mixture in metres whose average over cells is the fit."""
        sharp = fit.widened(-self.blur, self.own_side**2 / 12.0)
        return GaussianMixture(
            sharp.weights / sharp.weights.sum(),
            self.centre + sharp.means * self.unit,
            sharp.covariances * self.unit**2,
        )


def _growing_fits(cells: _Cells, limit: int, rng: np.random.Generator) -> Iterator[_Components]:
    """Yield converged fits of 1, 2, ... components."""
    # The features are about the mean in units of the spread, so one component is the unit one.
    single = _Components(np.ones(1), np.zeros((1, 2)), np.eye(2)[None])
    fit, _ = _maximise(cells, single, _ITERATIONS)
    yield fit
    for count in range(2, limit + 1):
        unexplained = np.maximum(cells.mass - cells.masses(fit), 0.0)
        total = unexplained.sum()
        chance = unexplained / total if total > 0.0 else cells.mass
        seeds = rng.choice(len(cells.mass), size=_CANDIDATES, p=chance)
        # A share of the ground for each component, and a smaller one for narrow features.
        variances = np.maximum(np.resize([1.0, 0.1], _CANDIDATES) / count, cells.floor)
        trials = [
            _maximise(cells, fit.with_one_more(cells.features[1:3, i], variance), _TRIAL_ITERATIONS)
            for i, variance in zip(seeds, variances, strict=True)
        ]
        best, _ = max(trials, key=lambda trial: trial[1])
        fit, _ = _maximise(cells, best, _ITERATIONS)
        yield fit


def _maximise(cells: _Cells, fit: _Components, iterations: int) -> tuple[_Components, float]:
    """Run EM; return the components and the log likelihood per unit of mass before the last."""
    likelihood = -math.inf
    for _ in range(iterations):
        logs = fit.log_coefficients() @ cells.features  # (K, N): sums over K run along memory
        peak = logs.max(axis=0)
        shares = np.exp(logs - peak)
        total = shares.sum(axis=0)
        previous, likelihood = likelihood, float(cells.mass @ (peak + np.log(total)))
        shares *= cells.mass / total
        moments = shares @ cells.features.T
        weights = np.maximum(moments[:, 0], np.finfo(float).tiny)
        mx, my, mxx, mxy, myy = moments[:, 1:].T / weights
        covariances = np.stack(
            (mxx - mx * mx, mxy - mx * my, mxy - mx * my, myy - my * my), axis=-1
        ).reshape(-1, 2, 2)
        fit = _Components(weights, np.column_stack((mx, my)), _floored(covariances, cells.floor))
        if likelihood - previous < _CONVERGED:
            break
    return fit, likelihood


def _floored(covariances: FloatArray, floor: float) -> FloatArray:
    """Raise the eigenvalues of (K, 2, 2) matrices to a floor."""
    values, vectors = np.linalg.eigh(covariances)
    if values.min() >= floor:
        return covariances
    values = np.maximum(values, floor)
    return (vectors * values[:, None, :]) @ np.swapaxes(vectors, 1, 2)


def _with_loss(
    raster: RasterMap, mixture: GaussianMixture, criterion: dict[int, float]
) -> MixtureFit:
    """Compare a mixture with the raster, cell by cell."""
    p = raster.probability.ravel() / raster.probability.sum()
    q = mixture.rasterize(raster.grid).ravel()
    has_mass = p > 0.0
    # The log of a mass that underflows is bounded, lest one far cell hides all others.
    ratio = p[has_mass] / np.maximum(q[has_mass], np.finfo(float).tiny)
    tenth = max(1, len(p) // 10)
    found = p[np.argpartition(q, -tenth)[-tenth:]].sum()
    return MixtureFit(
        mixture=mixture,
        total_variation=1.0 - float(np.minimum(p, q).sum()),
        kl_divergence=float(p[has_mass] @ np.log(ratio)),
        top_tenth_share=float(found / np.partition(p, -tenth)[-tenth:].sum()),
        mass_outside=max(0.0, 1.0 - float(q.sum())),
        criterion=criterion,
    )
