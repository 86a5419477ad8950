import pytest

from wisar_planner import InvalidInput, make_planner, planner_names
from wisar_planner.planners import Option, planner_options


def test_names_are_those_of_the_design():
    expected = {
        "lawnmower", "lhc_gw_conv", "greedy", "lookahead",
        "expanding_square", "sector", "creeping_line", "sac", "sac_search",
    }  # fmt: skip
    assert expected <= set(planner_names())


@pytest.mark.parametrize("name", planner_names())
def test_every_planner_makes_with_defaults_and_describes_its_options(name):
    planner = make_planner(name)
    assert planner.name == name
    for key, option in planner_options(name).items():
        assert isinstance(option, Option)
        assert option.name == key
        assert option.type in (bool, int, float, str)
        assert type(getattr(planner, key)) is option.type
        assert option.help.endswith(".")
        assert option.checked(option.default) == option.default


def test_unknown_planner_is_refused_with_a_suggestion():
    with pytest.raises(InvalidInput, match=r"'greedi' \(did you mean greedy\?\)"):
        make_planner("greedi")


def test_unknown_option_is_refused_with_a_suggestion():
    with pytest.raises(InvalidInput, match=r"no option heading \(did you mean headings\?\)"):
        make_planner("greedy", heading=3)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("greedy", {"headings": 2}, "headings must be at least 3"),
        ("greedy", {"headings": 8.5}, "headings must be a whole number"),
        ("greedy", {"headings": True}, "headings must be a whole number"),
        ("greedy", {"headings": "8"}, "headings must be a whole number"),
        ("greedy", {"far_share": 1.5}, "far_share must be at most 1"),
        ("lawnmower", {"lane_spacing": -1.0}, "lane_spacing must be at least 0"),
        ("lawnmower", {"lane_spacing": float("nan")}, "lane_spacing must be a finite number"),
        ("lawnmower", {"lane_spacing": None}, "lane_spacing must be a finite number"),
        ("lawnmower", {"from_start": 1}, "from_start must be true or false"),
        ("lhc_gw_conv", {"kernel": 4}, "kernel must be odd"),
        ("lhc_gw_conv", {"levels": 0}, "levels must be at least 1"),
        ("lookahead", {"time_budget_s": 0.0}, "time_budget_s must be at least"),
        ("lookahead", {"seed": -1}, "seed must be at least 0"),
        ("sector", {"radius": float("inf")}, "radius must be a finite number"),
        ("sac", {"model": ""}, "model must be a text that is not empty"),
        ("sac", {"model": 1}, "model must be a text that is not empty"),
        ("sac_search", {"model": None}, "model must be a text that is not empty"),
    ],
)
def test_bad_options_are_refused_by_name(name, options, message):
    with pytest.raises(InvalidInput, match=message):
        make_planner(name, **options)


def test_whole_floats_become_the_options_type():
    assert make_planner("lawnmower", lane_spacing=5).lane_spacing == 5.0
    assert isinstance(make_planner("lawnmower", lane_spacing=5).lane_spacing, float)
    assert make_planner("greedy", headings=8.0).headings == 8
