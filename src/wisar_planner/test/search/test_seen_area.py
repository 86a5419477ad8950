import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.search import SearchPath, SeenArea
from wisar_planner.search.seen_area import gains_along, probability_seen

RADIUS = 2.5
MIXTURE = GaussianMixture(
    [0.6, 0.4],
    [[8.0, 5.0], [-6.0, 12.0]],
    [[[120.0, 40.0], [40.0, 60.0]], [[50.0, -10.0], [-10.0, 90.0]]],
)
RASTER = RasterMap(MIXTURE.rasterize(Grid(-40, -40, 3.0, 27, 27)), Grid(-40, -40, 3.0, 27, 27))


def swath(points, radius=RADIUS, quad_segs=64):
    """The seen area as Shapely sees it; its arcs lack (pi / 2 / 64)^2 / 6 = 1e-4 of their area."""
    legs = [
        (shapely.Point(a) if (a == b).all() else shapely.LineString([a, b])).buffer(
            radius, quad_segs=quad_segs
        )
        for a, b in pairwise(points)
    ]
    return shapely.union_all(legs)


@st.composite
def paths(draw):
    """Paths of all sorts, most of them degenerate: lattices, retraced, tangent, overlapping."""
    count = draw(st.integers(1, 24))
    kind = draw(st.sampled_from(["lattice", "headings", "line", "free"]))
    if kind == "lattice":
        # Multiples of the radius: collinear steps, lanes two radii apart, repeats, hovering.
        moves = st.tuples(st.integers(-2, 2), st.integers(-2, 2))
        unit = draw(st.sampled_from([RADIUS, 2 * RADIUS, 3.0, 8.0]))
        steps = unit * np.array(draw(st.lists(moves, min_size=count, max_size=count)), float)
    elif kind == "headings":
        # Rounded sines: steps that are nearly, but not quite, collinear or retraced.
        parts = draw(st.sampled_from([2, 3, 4, 6, 8, 12]))
        turns = draw(st.lists(st.integers(0, 11), min_size=count, max_size=count))
        angles = 2 * math.pi / parts * np.array(turns)
        steps = 8.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    elif kind == "line":
        along = draw(st.lists(st.floats(-30, 30), min_size=count, max_size=count))
        angle = draw(st.floats(0, 3))
        steps = np.outer(along, [math.cos(angle), math.sin(angle)])
    else:
        moves = st.tuples(st.floats(-12, 12), st.floats(-12, 12))
        steps = np.array(draw(st.lists(moves, min_size=count, max_size=count)))
    points = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])
    if draw(st.booleans()):
        points = np.concatenate([points, points[-2::-1]])
    return points + draw(st.sampled_from([0.0, 1.0 / 3.0, 7e4]))


def at_origin(pdm, points):
    """Move a map with a path that was moved far away."""
    if points[0, 0] < 1e3:
        return pdm
    if isinstance(pdm, RasterMap):
        return RasterMap(pdm.probability, Grid(7e4 - 40, 7e4 - 40, 3.0, 27, 27))
    return GaussianMixture(pdm.weights, pdm.means + 7e4, pdm.covariances)


@pytest.mark.parametrize("pdm", [MIXTURE, RASTER], ids=["mixture", "raster"])
@given(points=paths())
@settings(max_examples=120)
def test_steps_sum_to_the_integral_from_scratch(pdm, points):
    pdm = at_origin(pdm, points)
    area = SeenArea(pdm, RADIUS)
    gains = [area.add(a, b) for a, b in pairwise(points)]
    whole = probability_seen(pdm, points, RADIUS)
    assert area.probability == pytest.approx(sum(gains), abs=1e-12)
    assert area.probability == pytest.approx(whole, abs=1e-9)
    polygon = pdm.integrate(swath(points))
    assert whole == pytest.approx(polygon, rel=1.2e-4, abs=1e-7)


@given(points=paths(), angle=st.floats(0, 6.3))
def test_candidates_gain_what_adding_them_gains(points, angle):
    pdm = at_origin(MIXTURE, points)
    area = SeenArea(pdm, RADIUS)
    for a, b in pairwise(points):
        area.add(a, b)
    turns = angle + np.arange(5) * 2 * math.pi / 5
    ends = points[-1] + 8.0 * np.column_stack([np.cos(turns), np.sin(turns)])
    before = area.probability
    gains = area.gains(points[-1], ends)
    assert area.probability == before
    for end, gain in zip(ends, gains, strict=True):
        assert area.copy().add(points[-1], end) == pytest.approx(gain, abs=1e-13)


@given(points=paths())
def test_more_path_never_sees_less_and_direction_does_not_matter(points):
    pdm = at_origin(MIXTURE, points)
    assert (gains_along(pdm, points, RADIUS) >= 0.0).all()
    back = probability_seen(pdm, points[::-1].copy(), RADIUS)
    assert back == pytest.approx(probability_seen(pdm, points, RADIUS), abs=1e-9)


@given(points=paths(), angle=st.floats(0, 6.3))
def test_turning_map_and_path_together_changes_nothing(points, angle):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    pdm = at_origin(MIXTURE, points)
    covariances = turn @ pdm.covariances @ turn.T
    turned = GaussianMixture(
        pdm.weights, pdm.means @ turn.T, (covariances + covariances.transpose(0, 2, 1)) / 2
    )
    assert probability_seen(turned, points @ turn.T, RADIUS) == pytest.approx(
        probability_seen(pdm, points, RADIUS), abs=2e-9
    )


def test_hovering_sees_a_disc():
    sigma = 7.0
    pdm = GaussianMixture([1.0], [[3.0, 4.0]], [[[sigma**2, 0], [0, sigma**2]]])
    assert SeenArea(pdm, RADIUS).add((3, 4), (3, 4)) == pytest.approx(
        -math.expm1(-(RADIUS**2) / (2 * sigma**2)), rel=1e-12
    )
    far = stats.ncx2.cdf(RADIUS**2 / sigma**2, 2, (30.0 / sigma) ** 2)
    assert SeenArea(pdm, RADIUS).add((33, 4), (33, 4)) == pytest.approx(far, rel=1e-8)


def test_retracing_gains_nothing():
    area = SeenArea(MIXTURE, RADIUS)
    for a, b in (((0, 0), (8, 0)), ((8, 0), (16, 0))):
        area.add(a, b)
    assert area.add((16, 0), (8, 0)) == 0.0
    assert area.add((12, 0), (3, 0)) == pytest.approx(0.0, abs=1e-9)
    assert area.gains((8, 0), [(0, 0), (4, 0), (8, 0)]) == pytest.approx(0.0, abs=1e-9)


def test_lanes_two_radii_apart_cover_a_rectangle_and_its_ends():
    lanes = [((0, 5.0 * k), (40, 5.0 * k)) for k in range(6)]
    area = SeenArea(MIXTURE, RADIUS)
    for a, b in lanes:
        area.add(a, b)
    polygon = shapely.union_all(
        [shapely.LineString(lane).buffer(RADIUS, quad_segs=512) for lane in lanes]
    )
    assert area.probability == pytest.approx(MIXTURE.integrate(polygon), rel=1e-6)


def test_a_ring_leaves_its_middle_unseen():
    angles = np.linspace(0, 2 * math.pi, 13)
    ring = 10.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert probability_seen(MIXTURE, ring, RADIUS) == pytest.approx(
        MIXTURE.integrate(swath(ring)), rel=1.2e-4
    )


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_lengths_scale(scale):
    pdm = GaussianMixture(MIXTURE.weights, MIXTURE.means * scale, MIXTURE.covariances * scale**2)
    points = np.array([[0, 0], [8, 0], [8, 8], [0, 8], [4, -4], [4, -4], [12, 4]]) * scale
    assert probability_seen(pdm, points, RADIUS * scale) == pytest.approx(
        probability_seen(MIXTURE, points / scale, RADIUS), abs=1e-11
    )


def test_dense_and_long_steps():
    rng = np.random.default_rng(2)
    dense = np.cumsum(rng.normal(0.0, 0.1 * RADIUS, (300, 2)), axis=0)
    long = rng.uniform(-4000, 4000, (12, 2))
    for points in (dense, long):
        assert gains_along(MIXTURE, points, RADIUS).sum() == pytest.approx(
            probability_seen(MIXTURE, points, RADIUS), abs=1e-12
        )
        assert probability_seen(MIXTURE, points, RADIUS) == pytest.approx(
            MIXTURE.integrate(swath(points)), rel=1.2e-4
        )


def test_five_thousand_steps_equal_the_integral_from_scratch():
    rng = np.random.default_rng(4)
    angles = np.cumsum(rng.normal(0.0, 0.8, 5000))
    points = np.cumsum(8.0 * np.column_stack([np.cos(angles), np.sin(angles)]), axis=0)
    points = np.abs((points + 200.0) % 400.0 - 200.0)  # Folded into 200 m x 200 m.
    pdm = GaussianMixture([1.0], [[80.0, 120.0]], [[[3000.0, 500.0], [500.0, 2000.0]]])
    total = gains_along(pdm, points, RADIUS).sum()
    whole = probability_seen(pdm, points, RADIUS)
    assert total == pytest.approx(whole, abs=1e-9)
    assert whole == pytest.approx(pdm.integrate(swath(points, quad_segs=32)), rel=2e-4)


SARENV = Path(__file__).parents[5] / "shared" / "data" / "sarenv" / "01.tif"


@pytest.mark.skipif(not SARENV.exists(), reason="the real maps are not here")
def test_a_real_map():
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(SARENV) as source:
        probability = np.flipud(source.read(1)).astype(float)
    rows, columns = probability.shape
    grid = Grid(-15.0 * columns, -15.0 * rows, 30.0, columns, rows)
    pdm = RasterMap(probability / probability.sum(), grid)
    rng = np.random.default_rng(0)
    turns = np.cumsum(rng.normal(0.0, 0.5, 300))
    points = np.cumsum(64.0 * np.column_stack([np.cos(turns), np.sin(turns)]), axis=0)
    path = SearchPath(points, 33.1)
    area = SeenArea(pdm, 33.1)
    for a, b in pairwise(points):
        area.add(a, b)
    assert area.probability == pytest.approx(path.seen_probability(pdm), abs=1e-9)
    assert area.probability == pytest.approx(pdm.integrate(path.seen_area(64)), rel=1e-4)
    # What this data set's README states for 100 km over the disc of 1.8 km.
    disc = shapely.Point(0, 0).buffer(1800.0, quad_segs=64)
    assert pdm.most_probable_mass(disc, 6.63e6) == pytest.approx(0.262, abs=2e-3)


def test_copies_are_independent():
    area = SeenArea(MIXTURE, RADIUS)
    area.add((0, 0), (8, 0))
    other = area.copy()
    gain = other.add((8, 0), (8, 8))
    assert area.probability < other.probability
    assert area.add((8, 0), (8, 8)) == gain


def test_monte_carlo_agrees():
    points = np.array([[0, 0], [8, 3], [2, 9], [6, -4]], dtype=float)
    persons = MIXTURE.sample(200_000, np.random.default_rng(0))
    seen = shapely.distance(shapely.LineString(points), shapely.points(persons)) <= RADIUS
    share = probability_seen(MIXTURE, points, RADIUS)
    assert seen.mean() == pytest.approx(share, abs=5 * math.sqrt(share / len(persons)))


def test_bad_steps_are_named():
    area = SeenArea(MIXTURE, RADIUS)
    with pytest.raises(InvalidInput, match="start"):
        area.add((math.nan, 0), (1, 1))
    with pytest.raises(InvalidInput, match="end"):
        area.add((0, 0), (1, 1, 1))
    with pytest.raises(InvalidInput, match="ends"):
        area.gains((0, 0), [[math.inf, 0]])
    with pytest.raises(InvalidInput, match="swath_radius"):
        SeenArea(MIXTURE, 0.0)
    assert area.probability == 0.0
    assert area.gains((0, 0), np.empty((0, 2))).shape == (0,)


def test_the_path_uses_the_same_area():
    path = SearchPath([[0, 0], [8, 0], [8, 8]], RADIUS)
    area = SeenArea(RASTER, RADIUS)
    area.add((0, 0), (8, 0))
    area.add((8, 0), (8, 8))
    assert path.seen_probability(RASTER) == pytest.approx(area.probability, abs=1e-13)
