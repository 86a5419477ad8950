import dataclasses
import json

import numpy as np
import pytest

from wisar_planner.evaluation.run import CURVE_STEPS, FIND_BINS, PlannerSpec, RunRecord
from wisar_planner.evaluation.runner import Evaluation
from wisar_planner.evaluation.scenario import Drone, RandomMaps
from wisar_planner.evaluation.summary import summarise
from wisar_planner.evaluation.tables import HEADERS, best_markdown, markdown, table_rows
from wisar_planner.policy.model import find_model, load_model

NAMES = ("lawnmower", "lhc_gw_conv")


def evaluation(runs, names=NAMES, scenario=None):
    specs = [PlannerSpec(name) for name in names]
    return Evaluation(specs, runs=runs, persons=10, scenario=scenario or RandomMaps())


def record(planner, index, e_p, finds=(100.0, 300.0), **changes):
    counts, _ = np.histogram(finds, np.arange(FIND_BINS + 1) * 512.0 / FIND_BINS)
    values = RunRecord(
        planner=planner,
        index=index,
        p_d=0.8 * e_p,
        e_p=e_p,
        p_a=0.8,
        bound=0.4,
        curve=(e_p * np.arange(CURVE_STEPS + 1) / CURVE_STEPS).tolist(),
        persons=10,
        found=len(finds),
        find_total=float(np.sum(finds)),
        find_squares=float(np.sum(np.square(finds))),
        find_counts=counts.tolist(),
        seconds=0.5,
        length=512.0,
        transit=0.0,
        offset=0.0,
        start=[1.0, 2.0],
        waypoints=[[1.0, 2.0], [3.0, 4.0]],
    )
    return dataclasses.replace(values, **changes)


@pytest.fixture(scope="module")
def results():
    rng = np.random.default_rng(0)
    records = [record("lawnmower", i, e) for i, e in enumerate(rng.uniform(0.0, 0.2, 30))]
    records += [
        record("lhc_gw_conv", i, e, finds=rng.uniform(0.0, 512.0, size=i % 7))
        for i, e in enumerate(rng.uniform(0.1, 0.4, 30))
    ]
    return records, summarise(evaluation(30), records)


def test_the_contracts_keys_are_there(results):
    _, summary = results
    assert set(summary) >= {"setup", "planners", "upper_bound"}
    assert set(summary["planners"]) == set(NAMES)
    for planner in summary["planners"].values():
        assert set(planner) >= {
            "runs",
            "e_p_mean",
            "e_p_std",
            "p_d_mean",
            "p_d_std",
            "found_pct",
            "dtf_mean_m",
            "dtf_std_m",
            "seconds_per_plan",
        }
    assert "e_p_mean" in summary["upper_bound"]


def test_means_and_spreads_are_numpys(results):
    records, summary = results
    e_p = np.array([r.e_p for r in records if r.planner == "lhc_gw_conv"])
    planner = summary["planners"]["lhc_gw_conv"]
    assert planner["e_p_mean"] == pytest.approx(e_p.mean(), rel=1e-12)
    assert planner["e_p_std"] == pytest.approx(e_p.std(ddof=1), rel=1e-12)
    assert planner["p_d_mean"] == pytest.approx(0.8 * e_p.mean(), rel=1e-12)
    assert planner["share_of_bound"] == pytest.approx(e_p.mean() / 0.4, rel=1e-12)
    assert planner["e_p_mean_ci"][0] < planner["e_p_mean"] < planner["e_p_mean_ci"][1]
    assert planner["curve"]["mean"][-1] == pytest.approx(e_p.mean(), rel=1e-12)
    thresholds = np.array(summary["thresholds"])
    at = np.searchsorted(thresholds, 0.25)
    assert planner["performance_profile"]["mean"][at] == pytest.approx(
        (e_p > thresholds[at]).mean()
    )


def test_distance_to_find_is_over_the_found_of_all_runs():
    finds = [(100.0,), (), (200.0, 300.0, 500.0)]
    records = [record("lawnmower", i, 0.1, finds=f) for i, f in enumerate(finds)]
    planner = summarise(evaluation(3, NAMES[:1]), records)["planners"]["lawnmower"]
    together = np.concatenate(finds)
    assert planner["found_pct"] == pytest.approx(100.0 * 4 / 30)
    assert planner["dtf_mean_m"] == pytest.approx(together.mean())
    assert planner["dtf_std_m"] == pytest.approx(together.std(ddof=1))
    assert planner["flown_per_person_m"] == pytest.approx((together.sum() + 26 * 512.0) / 30)
    assert planner["dtf_quantiles_m"]["p50"] == pytest.approx(200.0, abs=2.0)


def test_pairs_are_compared_map_by_map():
    offsets = np.linspace(0.0, 0.2, 10)
    records = [record("lawnmower", i, 0.1 + o) for i, o in enumerate(offsets)]
    records += [record("lhc_gw_conv", i, 0.15 + o) for i, o in enumerate(offsets)]
    (pair,) = summarise(evaluation(10), records)["comparisons"]
    assert (pair["planner"], pair["other"]) == NAMES
    assert pair["e_p_difference_mean"] == pytest.approx(-0.05)
    # The maps differ by far more than the planners; paired, the difference is exact.
    assert pair["e_p_difference_mean_ci"] == pytest.approx([-0.05, -0.05])
    assert pair["share_of_maps_better"] == 0.0


def test_the_best_planner_is_told_against_the_others_map_by_map():
    """Named second, it is 0.05 better on all maps but one, and behind for the first half."""
    offsets = np.linspace(0.0, 0.2, 10)
    late = (np.arange(CURVE_STEPS + 1) / CURVE_STEPS) ** 2
    records = [record("lawnmower", i, 0.1 + o) for i, o in enumerate(offsets)]
    records += [
        record("lhc_gw_conv", i, e_p, curve=(e_p * late).tolist())
        for i, e_p in enumerate([0.09, *(0.15 + offsets[1:])])
    ]
    summary = summarise(evaluation(10), records)
    (row,) = [
        line for line in best_markdown(summary).splitlines() if line.startswith("| lawnmower")
    ]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1] == f"{(9 * 0.05 - 0.01) / 10:.4f}"
    low, high = map(float, cells[2].split(" to "))
    assert -0.01 <= low < float(cells[1]) < high <= 0.05
    assert cells[3] == "90% of maps"
    # Means 0.2 x and 0.244 x^2 of the distance's share x meet at 0.82 of 512 m.
    assert float(cells[4]) == pytest.approx(0.2 / 0.244 * 512.0, abs=512.0 / CURVE_STEPS)
    assert float(cells[5]) == pytest.approx(0.2**2 / (4 * 0.244), abs=1e-3)
    assert best_markdown(summary) in markdown(summary)


def test_what_does_not_exist_is_null_in_json():
    summary = summarise(evaluation(1, NAMES[:1]), [record("lawnmower", 0, 0.1, finds=())])
    planner = json.loads(json.dumps(summary, allow_nan=False))["planners"]["lawnmower"]
    for name in ("e_p_std", "dtf_mean_m", "dtf_std_m"):
        assert planner[name] is None
    assert planner["found_pct"] == 0.0
    assert planner["e_p_mean_ci"] == [None, None]
    markdown(summary)


def test_table_stands_beside_the_papers_on_the_papers_setup_alone(results):
    _, summary = results
    rows = list(table_rows(summary))
    assert rows[3][HEADERS.index("flown per person, m")] == "480.9"  # 11.86% at 249.37 m of 512
    names = [row[0] for row in rows]
    assert names == [
        "lawnmower",
        "paper's lawnmower",
        "lhc_gw_conv",
        "paper's LHC_GW_CONV",
        "upper bound",
    ]
    other = RandomMaps(drone=Drone(max_distance=100.0))
    records = [record("lawnmower", 0, 0.1)]
    summary = summarise(evaluation(1, NAMES[:1], other), records)
    assert [row[0] for row in table_rows(summary)] == ["lawnmower", "upper bound"]


def test_table_is_valid_markdown_and_says_how_paths_begin():
    records = [
        record("lawnmower", 0, 0.1, offset=30.0),
        record("lhc_gw_conv", 0, 0.1, transit=54.2),
    ]
    text = markdown(summarise(evaluation(1), records))
    main, against = (
        [line.count("|") for line in part.splitlines() if line.startswith("|")]
        for part in text.split("against the others")
    )
    assert set(main) == {len(HEADERS) + 1}
    assert against == [7, 7, 7]
    assert "own first point" in text
    assert "start, leg of 54 m" in text


def test_results_tell_which_policy_they_are_of():
    results = summarise(evaluation(1, ("sac",)), [record("sac", 0, 0.3)])
    policy = results["setup"]["planners"]["sac"]
    assert policy["model"] == "sac"
    assert policy["model_sha256"] == load_model(find_model("sac")).card["weights_sha256"]
