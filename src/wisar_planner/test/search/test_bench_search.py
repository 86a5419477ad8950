import pytest

from wisar_planner.evaluation import bench_search


def test_our_error_and_the_peers_time():
    row = bench_search.seen_probability_64_waypoints(
        paths=2, repeats=1, references=1, quad_segs=300
    )
    assert row.name in bench_search.ROWS
    assert row.details["relative_error"] < 1e-6
    assert row.ours > 0
    if row.peer is not None:
        # The peer's buffer has 8 segments per quarter circle.
        assert row.details["peer_relative_difference"] < 5e-3
        assert row.ratio == pytest.approx(row.peer / row.ours)


def test_the_gradient_is_that_of_differences_and_costs_less():
    row = bench_search.gradient_64_waypoints(paths=3, repeats=2)
    assert row.name in bench_search.ROWS
    assert row.details["relative_difference_median"] < 1e-4
    # Generous, as the machine may be busy: the peer evaluates the path 131 times.
    assert row.ratio > 5.0


def test_a_step_late_costs_what_a_step_early_costs():
    row = bench_search.incremental_step_growth_50_to_5000(repeats=5)
    assert row.name in bench_search.ROWS
    # Generous: the machine may be busy.
    assert row.ours < 3.0
