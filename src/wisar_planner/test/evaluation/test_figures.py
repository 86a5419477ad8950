import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from wisar_planner.evaluation.figures import draw_profile, save_figures
from wisar_planner.evaluation.gallery import choose_maps, draw_gallery
from wisar_planner.evaluation.palette import looks
from wisar_planner.evaluation.run import PlannerSpec
from wisar_planner.evaluation.runner import Evaluation, run_evaluation
from wisar_planner.evaluation.scenario import Drone, RandomMaps
from wisar_planner.evaluation.summary import summarise
from wisar_planner.planners.registry import planner_names

SHORT = RandomMaps(drone=Drone(max_distance=160.0))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    evaluation = Evaluation(
        [PlannerSpec("lawnmower"), PlannerSpec("lhc_gw_conv")], runs=6, persons=50, scenario=SHORT
    )
    records = run_evaluation(evaluation, jobs=1)
    results = summarise(evaluation, records)
    folder = tmp_path_factory.mktemp("figures")
    return records, save_figures(folder, results, records, SHORT)


def test_every_figure_shows_both_planners_in_their_colours(drawn):
    _, paths = drawn
    assert len(paths) == 5
    for path in paths:
        pixels = (imread(path)[..., :3] * 255).astype(np.uint32) @ (1 << 16, 1 << 8, 1)
        colours, counts = np.unique(pixels, return_counts=True)
        colours = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1) / 255.0
        for name, look in looks(["lawnmower", "lhc_gw_conv"]).items():
            # Filled areas are translucent: the colour on its way to white.
            blends = 1.0 - np.linspace(0.2, 1.0, 21)[:, None] * (
                1.0 - np.array(to_rgb(look.colour))
            )
            near = np.abs(colours[:, None, :] - blends).max(axis=2).min(axis=1) < 0.02
            assert counts[near].sum() > 200, f"{name} is missing in {path.name}"


def test_the_profile_is_as_wide_as_its_best_planner_needs():
    """Where e_p passes 1, as probability outside the area counts, the curve never comes to 0."""
    thresholds = [0.0, 0.25, 0.5, 0.75, 1.0]

    def profile(*mean: float):
        curve = {"mean": mean, "low": mean, "high": mean}
        return {"e_p_mean": sum(mean), "performance_profile": curve}

    good, bad = profile(1.0, 1.0, 1.0, 1.0, 0.3), profile(1.0, 0.6, 0.0, 0.0, 0.0)
    styles = looks(["good", "bad"])
    for planners, last in (({"good": good, "bad": bad}, 1.0), ({"bad": bad}, 0.5)):
        results = {"thresholds": thresholds, "planners": planners}
        assert draw_profile(results, styles).axes[0].get_xlim() == (0.0, last)


def test_one_run_in_which_nobody_is_found_can_be_drawn(tmp_path):
    evaluation = Evaluation([PlannerSpec("lawnmower")], runs=1, persons=1, scenario=SHORT)
    records = run_evaluation(evaluation, jobs=1)
    results = summarise(evaluation, records)
    results["planners"]["lawnmower"]["dtf_quantiles_m"]["p50"] = None
    assert all(path.stat().st_size for path in save_figures(tmp_path, results, records, SHORT))


def test_a_path_of_one_waypoint_is_drawn_as_the_disc_that_it_sees():
    specs = [PlannerSpec("greedy"), PlannerSpec("lawnmower")]
    unflyable = RandomMaps(drone=Drone(step_length=8.0, max_distance=5.0))
    evaluation = Evaluation(specs, runs=1, persons=1, scenario=unflyable)
    records = run_evaluation(evaluation, jobs=1)
    assert len(records[0].waypoints) == 1
    styles = looks([spec.name for spec in specs])
    figure = draw_gallery(summarise(evaluation, records), records, unflyable, styles)
    figure.canvas.draw()
    seen = figure.axes[0].patches[1].get_path().get_extents()
    assert (seen.width, seen.height) == pytest.approx((5.0, 5.0))


def test_gallery_shows_an_easy_a_median_and_a_hard_map(drawn):
    records, _ = drawn
    share = {i: np.mean([r.e_p / r.bound for r in records if r.index == i]) for i in range(6)}
    ordered = sorted(share, key=share.__getitem__)
    assert [index for _, index in choose_maps(records)] == [ordered[5], ordered[2], ordered[0]]
    assert len(choose_maps([r for r in records if r.index == 0])) == 1


def test_planners_look_different_even_in_grey():
    found = looks([*planner_names(), "one", "two", "three", "four"])
    assert len({(look.colour, look.dash) for look in found.values()}) == len(found)
    assert found == looks([*planner_names(), "one", "two", "three", "four"])
    grey = {
        (round(float(np.dot(to_rgb(look.colour), (0.299, 0.587, 0.114))), 2), look.dash)
        for look in looks(list(planner_names())).values()
    }
    assert len(grey) == len(planner_names())
