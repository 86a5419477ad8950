import dataclasses
import math

import numpy as np
import pytest
import torch

from wisar_planner import GaussianMixture
from wisar_planner.errors import InvalidInput
from wisar_planner.policy.observation import cells_per_step
from wisar_planner.policy.unseen_map import BLOCK, OUTSIDE
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.worlds import WorldDistribution, _fields, random_worlds


def as_mixture(weights, means, deviations, turn):
    """Return one world's mixture, and what its density on the raster is multiplied by."""
    cos, sin = np.cos(turn), np.sin(turn)
    axes = np.stack([np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)], axis=-2)
    covariances = np.einsum("kai,ka,kaj->kij", axes, deviations**2, axes)
    used = weights > 0.0
    total = weights.sum()
    mixture = GaussianMixture(weights[used] / total, means[used], covariances[used])
    return mixture, 2.0 * math.pi * total


def test_worlds_keep_their_bounds(distribution, generator):
    d = distribution
    worlds = random_worlds(64, d, generator)
    assert worlds.density.shape == (64, d.side, d.side)
    assert d.side % BLOCK == d.window % BLOCK == 0
    for each in worlds:
        assert torch.isfinite(each).all()
    assert (worlds.low < worlds.high).all()
    assert ((worlds.start >= worlds.low) & (worlds.start <= worlds.high)).all()
    assert (worlds.heading >= 0.0).all()
    assert (worlds.heading <= 2.0 * math.pi).all()
    torch.testing.assert_close(worlds.step, cells_per_step(worlds.radius / worlds.step))
    radii = worlds.radius / worlds.step
    paper = worlds.steps == 64.0
    if d.paper_share < 1.0:
        paper &= (radii - 0.3125).abs() < 1e-5
        varied = ~paper
        assert (radii[varied] >= d.radii[0] - 1e-5).all()
        assert (radii[varied] <= d.radii[1] + 1e-5).all()
        assert (worlds.steps[varied] >= d.budgets[0]).all()
        assert (worlds.steps[varied] <= d.budgets[1]).all()
    torch.testing.assert_close(radii[paper], torch.full_like(radii[paper], 0.3125))
    sides = (worlds.high - worlds.low)[paper] / worlds.step[paper, None]
    torch.testing.assert_close(sides, torch.full_like(sides, 18.75))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"sides": (1.0, 1.5)}, "sides must be two rising numbers from 2.0 up"),
        ({"radii": (0.2, 12.0)}, "radii must leave room for sides of 10 steps, but 12 leaves"),
        ({"radii": (0.2, 12.0), "sides": (2.0, 3.0)}, r"but 12 leaves 0\.0"),
        ({"radii": (0.05, 0.06)}, "radii must leave room for sides of 10 steps"),
    ],
)
def test_worlds_that_could_not_keep_their_bounds_are_refused(fields, words) -> None:
    with pytest.raises(InvalidInput, match=words):
        WorldDistribution(paper_share=0.5, **fields)


def test_the_widest_swaths_that_are_taken_keep_the_bounds_of_their_worlds(generator) -> None:
    distribution = WorldDistribution(paper_share=0.0, sides=(9.5, 29.0), radii=(11.0, 11.0))
    with pytest.raises(InvalidInput, match=r"but 11 leaves 9\.5"):
        dataclasses.replace(distribution, sides=(9.6, 29.0))
    assert distribution.window <= distribution.side
    worlds = random_worlds(64, distribution, generator)
    sides = (worlds.high - worlds.low) / worlds.step[:, None]
    assert sides.min() >= 9.5 - 1e-4
    assert (worlds.low >= worlds.radius[:, None] + BLOCK).all()
    assert (worlds.high <= distribution.side - worlds.radius[:, None] - BLOCK).all()


def test_a_world_whose_only_mode_is_drawn_with_a_weight_of_zero_has_one(monkeypatch) -> None:
    """Which happens once in millions of draws."""
    monkeypatch.setattr(torch, "rand", lambda *shape, **_: torch.zeros(shape))
    distribution = WorldDistribution(paper_share=0.0, modes=1)
    environment = SearchEnvironment(2, distribution, torch.Generator())
    density = environment.unseen.levels[0]
    assert torch.isfinite(density).all()
    assert (density.amax(dim=(1, 2)) > 0.0).all()


def test_the_map_counts_within_the_swath_of_the_area_alone(distribution, generator):
    worlds = random_worlds(32, distribution, generator)
    centre = torch.arange(distribution.side) + 0.5
    reach = worlds.radius[:, None]
    x, y = (
        (centre > worlds.low[:, axis, None] - reach) & (centre < worlds.high[:, axis, None] + reach)
        for axis in (0, 1)
    )
    inside = y[:, :, None] & x[:, None, :]
    assert (worlds.density[inside] >= 0.0).all()
    assert (worlds.density[~inside] == OUTSIDE).all()
    assert (worlds.density.amax(dim=(1, 2)) > 0.0).all()


def test_swaths_of_steps_in_the_area_stay_on_the_raster(distribution, generator):
    worlds = random_worlds(64, distribution, generator)
    # What lies off the raster reads as its border, so the border is outside.
    border = torch.ones(distribution.side, distribution.side, dtype=torch.bool)
    border[BLOCK:-BLOCK, BLOCK:-BLOCK] = False
    assert (worlds.density[:, border] == OUTSIDE).all()
    assert (worlds.low >= worlds.radius[:, None] + BLOCK).all()
    assert (worlds.high <= distribution.side - worlds.radius[:, None] - BLOCK).all()
    assert (worlds.step + 2.0 * worlds.radius + 2.0 <= distribution.window).all()


def test_the_density_is_the_mixtures(generator, mixtures):
    worlds = random_worlds(6, WorldDistribution(paper_share=0.3), generator)
    for i, mixture in enumerate(zip(*mixtures[0], strict=True)):
        pdm, factor = as_mixture(*mixture)
        rows, columns = np.nonzero(worlds.density[i].numpy() >= 0.0)
        points = np.stack([columns, rows], axis=-1) + 0.5
        expected = factor * pdm.density(points)
        found = worlds.density[i].numpy()[rows, columns]
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5 * expected.max())


def test_paper_worlds_have_the_papers_mixture(generator, mixtures):
    worlds = random_worlds(200, WorldDistribution(), generator)
    weights, means, deviations, _ = mixtures[0]
    assert weights.shape == (200, 4)
    assert (weights == 1.0).all()
    np.testing.assert_allclose(deviations / worlds.step.numpy()[:, None, None] * 8.0, 500.0**0.5)
    low, high = worlds.low.numpy()[:, None], worlds.high.numpy()[:, None]
    share = (means - low) / (high - low)
    assert (share >= 0.0).all()
    assert (share <= 1.0).all()
    assert share.mean() == pytest.approx(0.5, abs=0.03)
    assert share.std() == pytest.approx(12.0**-0.5, abs=0.02)


def test_fields_are_smooth_noise_of_the_contrast_they_are_drawn_with(generator):
    """Their logarithm has the deviation asked for, and the correlation of smoothed noise."""
    side, smoothness, contrast = 192, torch.tensor([2.0, 5.0, 9.0]), torch.tensor([0.5, 1.0, 2.0])
    fields = _fields(side, smoothness, contrast, generator).log().double().numpy()
    np.testing.assert_allclose(fields.std(axis=(1, 2)), contrast, rtol=1e-3)
    for field, sigma in zip(fields, smoothness.tolist(), strict=True):
        scaled = (field - field.mean()) / field.std()
        for apart in (1, int(sigma), int(2 * sigma)):
            # The correlation of white noise that a Gaussian has smoothed.
            expected = math.exp(-((apart / (2.0 * sigma)) ** 2))
            for axis in (0, 1):
                found = (scaled * np.roll(scaled, apart, axis=axis)).mean()
                assert found == pytest.approx(expected, abs=0.15)


def test_a_share_of_the_worlds_that_vary_are_fields(generator, mixtures):
    distribution = WorldDistribution(paper_share=0.5, field_share=0.5)
    worlds = random_worlds(60, distribution, generator)
    fields = 0
    for i, mixture in enumerate(zip(*mixtures[0], strict=True)):
        pdm, factor = as_mixture(*mixture)
        rows, columns = np.nonzero(worlds.density[i].numpy() >= 0.0)
        expected = factor * pdm.density(np.stack([columns, rows], axis=-1) + 0.5)
        found = worlds.density[i].numpy()[rows, columns]
        fields += not np.allclose(found, expected, rtol=1e-2, atol=1e-3 * expected.max())
    assert 6 <= fields <= 24


def test_worlds_without_fields_are_drawn_as_if_there_were_none():
    one, other = (
        random_worlds(2, WorldDistribution(field_share=share), torch.Generator().manual_seed(2))
        for share in (0.0, 1e-9)
    )
    torch.testing.assert_close(one.density, other.density, rtol=0.0, atol=0.0)


def test_worlds_repeat_with_the_seed(distribution):
    first, again, other = (
        random_worlds(3, distribution, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2)
    )
    for one, two in zip(first, again, strict=True):
        torch.testing.assert_close(one, two, rtol=0.0, atol=0.0)
    assert (first.start != other.start).any()
