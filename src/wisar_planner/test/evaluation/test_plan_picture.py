"""The picture of a plan: what is drawn where, read back from the figure."""

import matplotlib.image
import numpy as np
import pytest
import shapely

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation import plan_picture as module
from wisar_planner.evaluation.palette import looks
from wisar_planner.evaluation.plan_picture import plan_picture
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.search import SearchArea, SearchPath, SearchProblem, upper_bound

HILL = GaussianMixture([1.0], [[40.0, 60.0]], [500.0 * np.eye(2)])


def problem_on(pdm, side=150.0, **changes):
    values = {
        "start": (20.0, 30.0),
        "step_length": 8.0,
        "swath_radius": 2.5,
        "max_distance": 200.0,
        **changes,
    }
    return SearchProblem(pdm=pdm, area=SearchArea.rectangle(0.0, 0.0, side, side), **values)


def path_of(*waypoints):
    return SearchPath(np.array(waypoints, dtype=float), swath_radius=2.5, planner="greedy")


ACROSS = path_of((20, 30), (40, 60), (110, 90), (120, 20))


@pytest.fixture
def figures(monkeypatch):
    """The figures that are saved, to look at what they hold."""
    saved = []
    save = module.Figure.savefig
    monkeypatch.setattr(
        module.Figure,
        "savefig",
        lambda figure, *args, **kwargs: (saved.append(figure), save(figure, *args, **kwargs)),
    )
    return saved


def test_map_and_curve_of_one_path(tmp_path, figures):
    problem = problem_on(HILL)
    plan_picture(problem, {"greedy": ACROSS}, tmp_path / "plan.png", title="Glen")
    assert matplotlib.image.imread(tmp_path / "plan.png").std() > 0.05
    chart, curves = figures[0].axes[:2]
    line = chart.collections[0]
    drawn = np.array([segment[0] for segment in line.get_segments()])
    np.testing.assert_array_equal(drawn, ACROSS.waypoints[:-1])
    assert chart.get_ylim()[0] < chart.get_ylim()[1], "north is up"
    assert chart.get_aspect() == 1.0
    seen = curves.collections[0].get_segments()[-1][-1]
    assert seen == pytest.approx([ACROSS.length, ACROSS.seen_probability(HILL)])
    (bound,) = (curve for curve in curves.lines if curve.get_linestyle() == "--")
    heights = np.interp(
        [segment[-1][0] for segment in curves.collections[0].get_segments()],
        *bound.get_data(),
    )
    seen = [segment[-1][1] for segment in curves.collections[0].get_segments()]
    assert (np.array(seen) <= heights + 1e-3).all()
    assert figures[0].get_suptitle() == "Glen"


def test_the_map_shows_the_hill_where_it_is(tmp_path, figures):
    plan_picture(problem_on(HILL), {"greedy": ACROSS}, tmp_path / "plan.png")
    (image,) = figures[0].axes[0].images
    cells, (left, right, bottom, up) = image.get_array(), image.get_extent()
    row, column = np.unravel_index(np.argmax(cells), cells.shape)
    east = left + (column + 0.5) * (right - left) / cells.shape[1]
    north = bottom + (row + 0.5) * (up - bottom) / cells.shape[0]
    assert image.origin == "lower"
    assert (east, north) == pytest.approx((40.0, 60.0), abs=1.0)


def test_several_paths_have_a_line_and_a_legend_entry_each(tmp_path, figures):
    other = path_of((20, 30), (20, 100))
    plan_picture(problem_on(HILL), {"greedy": ACROSS, "lawnmower": other}, tmp_path / "plan.svg")
    labels = [text.get_text() for text in figures[0].axes[1].get_legend().get_texts()]
    assert any(label.startswith("greedy: ") and "of the bound" in label for label in labels)
    assert any(label.startswith("lawnmower: ") for label in labels)
    drawn = {line.get_color(): line.get_xydata() for line in figures[0].axes[0].lines}
    for name, path in (("greedy", ACROSS), ("lawnmower", other)):
        colour = looks(["greedy", "lawnmower"])[name].colour
        np.testing.assert_array_equal(drawn[colour], path.waypoints)
    assert (tmp_path / "plan.svg").read_text().startswith("<?xml")


def test_the_legend_tells_the_share_of_the_bound_of_the_budget_where_it_holds(tmp_path, figures):
    problem = problem_on(HILL)
    short, outside = path_of((20, 30), (40, 60)), path_of((20, 30), (20, -30))
    plan_picture(problem, {"short": short, "outside": outside}, tmp_path / "plan.png")
    labels = [text.get_text() for text in figures[0].axes[1].get_legend().get_texts()]
    share = short.probability_efficiency(problem) / upper_bound(problem)
    told = {label.split(":")[0]: label for label in labels}
    assert told["short"].endswith(f", {share:.1%} of the bound")
    assert "of the bound" not in told["outside"]


def test_a_path_that_passes_the_bound_outside_the_area_stays_in_the_picture(tmp_path, figures):
    """Of the map's probability only the rim lies in the area."""
    area = SearchArea.rectangle(0.0, 0.0, 100.0, 20.0)
    problem = SearchProblem(HILL, area, (20.0, 10.0), 8.0, swath_radius=2.5, max_distance=120.0)
    path = path_of((20, 10), (40, 40), (40, 80))
    plan_picture(problem, {"outside": path}, tmp_path / "plan.png")
    assert path.seen_probability(HILL) < figures[0].axes[1].get_ylim()[1]


def test_a_short_path_on_a_large_map_is_shown_near(tmp_path, figures):
    plan_picture(problem_on(HILL, side=20_000.0), {"greedy": ACROSS}, tmp_path / "plan.png")
    west, east = figures[0].axes[0].get_xlim()
    assert east - west < 300.0
    assert figures[0].axes[1].child_axes, "an overview says where this is"


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_rasters_areas_with_holes_and_single_points_can_be_drawn(tmp_path, turn):
    grid = Grid(0.0, 0.0, 10.0, 15, 15)
    raster = RasterMap(HILL.rasterize(grid), grid)
    area = shapely.affinity.rotate(shapely.box(0, 0, 150, 150), turn).difference(
        shapely.Point(100.0, 100.0).buffer(20.0)
    )
    problem = SearchProblem(
        pdm=raster, area=SearchArea.from_polygon(area), start=(20.0, 30.0), step_length=8.0,
        swath_radius=2.5, max_distance=4.0,
    )  # fmt: skip
    plan_picture(problem, {"greedy": path_of((20, 30))}, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000


def test_no_path_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="paths"):
        plan_picture(problem_on(HILL), {}, tmp_path / "plan.png")


@pytest.mark.parametrize(
    ("length", "round_one"),
    [(1.0, 1.0), (1.9, 1.0), (499.0, 200.0), (5000.0, 5000.0), (0.07, 0.05)],
)
def test_scale_bars_have_round_lengths(length, round_one):
    assert module._round_down(length) == pytest.approx(round_one)
