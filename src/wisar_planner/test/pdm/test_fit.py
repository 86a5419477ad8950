"""Mixtures fitted to rasters: known ones are found again, real ones within their loss."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.pdm.fit import fit_mixture
from wisar_planner.pdm.gis import load_map

SARENV = Path(__file__).parents[5] / "shared" / "data" / "sarenv"
GRID = Grid(-500.0, 200.0, 8.0, 125, 125)


def separate_mixture(count, seed):
    """Components with distinct centres, elongated in random directions."""
    rng = np.random.default_rng(seed)
    means = []
    while len(means) < count:
        mean = rng.uniform(150.0, 850.0, 2)
        if all(np.hypot(*(mean - other)) > 220.0 for other in means):
            means.append(mean)
    angles, scales = rng.uniform(0.0, np.pi, count), rng.uniform(20.0, 45.0, (count, 2))
    axes = np.stack(
        (np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)), axis=-1
    ).reshape(count, 2, 2)
    covariances = np.einsum("kij,ki,kil->kjl", axes, scales**2, axes)
    return GaussianMixture(
        rng.dirichlet(np.full(count, 20.0)),
        np.array(means) + np.array([-500.0, 200.0]),
        covariances,
    )


def rasterized(mixture, grid=GRID):
    return RasterMap(mixture.rasterize(grid), grid)


def matched(fit, mixture):
    """Order of the fit's components that is nearest to the mixture's."""
    distances = np.linalg.norm(fit.means[:, None] - mixture.means[None], axis=2)
    return distances.argmin(axis=0)


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_the_number_and_the_parameters_of_a_mixture_are_found_again(count, seed):
    mixture = separate_mixture(count, seed)
    fit = fit_mixture(rasterized(mixture))
    assert fit.components == count
    order = matched(fit.mixture, mixture)
    assert sorted(order) == list(range(count))
    assert fit.mixture.means[order] == pytest.approx(mixture.means, abs=1.0)
    assert fit.mixture.weights[order] == pytest.approx(mixture.weights, abs=0.01)
    assert fit.mixture.covariances[order] == pytest.approx(mixture.covariances, rel=0.05, abs=25.0)
    assert fit.total_variation < 0.01
    assert fit.kl_divergence < 1e-3


@pytest.mark.parametrize("cell", [2.0, 8.0, 25.0])
def test_the_size_of_the_cells_does_not_widen_the_fit(cell):
    mixture = GaussianMixture([1.0], [[0.0, 700.0]], [[[900.0, 300.0], [300.0, 600.0]]])
    raster = rasterized(mixture, Grid.covering((-300.0, 400.0, 300.0, 1000.0), cell))
    fit = fit_mixture(raster, components=1).mixture
    assert fit.means == pytest.approx(mixture.means, abs=0.1)
    # Uncorrected, cells of 25 m would add 52 square metres.
    assert fit.covariances == pytest.approx(mixture.covariances, abs=3.0)


def test_losses_agree_with_their_definitions():
    rng = np.random.default_rng(3)
    raster = RasterMap(rng.dirichlet(np.full(400, 0.5)).reshape(20, 20), Grid(0, 0, 10, 20, 20))
    fit = fit_mixture(raster, components=2)
    p, q = raster.probability, fit.mixture.rasterize(raster.grid)
    outside = 1.0 - q.sum()
    assert fit.mass_outside == pytest.approx(outside, abs=1e-9)
    assert fit.total_variation == pytest.approx(0.5 * (np.abs(p - q).sum() + outside), abs=1e-9)
    assert fit.kl_divergence == pytest.approx((p * np.log(p / q)).sum(), abs=1e-9)
    best = np.sort(p.ravel())[-40:].sum()
    chosen = p.ravel()[np.argsort(q.ravel())[-40:]].sum()
    assert fit.top_tenth_share == pytest.approx(chosen / best, abs=1e-9)


def test_no_region_is_off_by_more_than_the_total_variation():
    rng = np.random.default_rng(5)
    raster = RasterMap(rng.dirichlet(np.full(900, 0.3)).reshape(30, 30), Grid(0, 0, 10, 30, 30))
    fit = fit_mixture(raster, max_components=3)
    for x0, y0, width, height in rng.integers(0, 15, size=(20, 4)) * 10:
        region = shapely.box(x0, y0, x0 + width + 10, y0 + height + 10)
        error = abs(fit.mixture.integrate(region) - raster.integrate(region))
        assert error <= fit.total_variation + 1e-9


def test_more_components_lose_less():
    raster = rasterized(separate_mixture(5, 1))
    losses = [fit_mixture(raster, components=k).total_variation for k in (1, 3, 5)]
    assert losses[0] > losses[1] > losses[2]


def test_the_same_seed_gives_the_same_fit():
    raster = rasterized(separate_mixture(4, 2))
    one, two = (fit_mixture(raster, seed=7).mixture for _ in range(2))
    np.testing.assert_array_equal(one.means, two.means)
    np.testing.assert_array_equal(one.covariances, two.covariances)


def test_mass_below_one_is_fitted_as_if_it_were_one():
    raster = rasterized(separate_mixture(2, 4))
    part = RasterMap(0.5 * raster.probability, raster.grid)
    assert fit_mixture(part).mixture.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert fit_mixture(part).total_variation < 0.01


@pytest.mark.parametrize(
    "masses", [[[1.0]], [[0.0, 1.0], [0.0, 0.0]], [[0.5, 0.5]]], ids=["one", "corner", "line"]
)
def test_hardly_any_cells_give_a_component_as_wide_as_a_cell(masses):
    masses = np.array(masses)
    rows, columns = masses.shape
    fit = fit_mixture(RasterMap(masses, Grid(0.0, 0.0, 10.0, columns, rows)))
    assert fit.components == 1
    assert np.linalg.eigvalsh(fit.mixture.covariances).min() == pytest.approx(100 / 12, rel=1e-6)


@pytest.mark.parametrize(
    "options",
    [{"components": 0}, {"components": 1.5}, {"max_components": 0}, {"components": 5000}],
    ids=str,
)
def test_impossible_numbers_of_components_are_refused(options):
    with pytest.raises(InvalidInput, match="components"):
        fit_mixture(rasterized(separate_mixture(1, 0)), **options)


# What the fit lost when these were measured, rounded up.
@pytest.mark.parametrize(("name", "loss"), [("01", 0.27), ("06", 0.06)])
def test_real_maps_are_fitted_within_their_known_loss(name, loss):
    path = SARENV / f"{name}.tif"
    if not path.exists():
        pytest.skip("the SAREnv maps are not here")
    fit = fit_mixture(load_map(path).pdm)
    assert fit.total_variation < loss
    assert fit.top_tenth_share > 0.9
    assert f"{fit.components} components" in str(fit)
