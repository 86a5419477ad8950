import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
import shapely

from wisar_planner import GaussianMixture, RasterMap
from wisar_planner.cli.evaluate_worlds import selected_worlds
from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation import worlds_table
from wisar_planner.evaluation.scenario import FixedMap, RandomMaps
from wisar_planner.evaluation.worlds import read_worlds
from wisar_planner.evaluation.worlds_table import worlds_markdown
from wisar_planner.policy.model import find_model, load_model, save_model
from wisar_planner.search import upper_bound

SHIPPED = Path(__file__).parents[4] / "config" / "worlds.yaml"


def worlds_of(tmp_path, text):
    path = tmp_path / "worlds.yaml"
    path.write_text(text)
    return read_worlds(path)


def chosen(file, names, maps=None):
    """Return the names of the worlds of a file that `--world` selects."""
    args = Namespace(worlds=file, world=names, world_maps=maps)
    return [world.name for world in selected_worlds(args)]


def test_every_shipped_world_can_be_chosen_alone(tmp_path):
    names = [world.name for world in read_worlds(SHIPPED, maps=tmp_path)]
    assert [chosen(SHIPPED, name, tmp_path) for name in names] == [[name] for name in names]


def test_a_world_that_says_nothing_is_the_papers(tmp_path):
    (world,) = worlds_of(tmp_path, "worlds: {paper: {}}")
    assert world.scenario == RandomMaps()


@pytest.mark.parametrize("seed", range(2))
def test_every_shipped_world_makes_problems_that_its_seed_decides(seed, tmp_path):
    worlds = read_worlds(SHIPPED, maps=tmp_path)
    assert len({world.name for world in worlds}) == len(worlds) > 20
    for world in worlds:
        if world.scenario is None:
            assert world.name == "sarenv"
            continue
        first, again = (world.scenario.problem(seed, 1) for _ in range(2))
        other = world.scenario.problem(seed, 2)
        points = np.random.default_rng(0).uniform(*np.reshape(first.area.bounds, (2, 2)), (20, 2))
        np.testing.assert_array_equal(first.start, again.start)
        np.testing.assert_array_equal(first.pdm.density(points), again.pdm.density(points))
        assert (first.pdm.density(points) != other.pdm.density(points)).any()
        assert first.max_distance == world.scenario.drone.max_distance
        json.dumps(world.scenario.description(), allow_nan=False)


def test_a_scaled_world_is_the_same_search(tmp_path):
    small, large = worlds_of(tmp_path, "worlds: {a: {}, b: {scale: 10}}")
    one, ten = (world.scenario.problem(3, 0) for world in (small, large))
    np.testing.assert_allclose(ten.start, 10.0 * one.start)
    assert ten.steps == one.steps
    assert upper_bound(ten) == pytest.approx(upper_bound(one), rel=1e-6)


def test_mixtures_of_all_shapes_keep_to_their_widths(tmp_path):
    (world,) = worlds_of(tmp_path, "worlds: {a: {deviations: [4, 40], components: 9}}")
    pdm = world.scenario.problem(0, 0).pdm
    assert isinstance(pdm, GaussianMixture)
    widths = np.sqrt(np.linalg.eigvalsh(pdm.covariances))
    assert 4.0 <= widths.min() < widths.max() <= 40.0
    assert np.abs(pdm.covariances[:, 0, 1]).max() > 1.0
    assert len(set(pdm.weights)) == 9


def test_a_rasterised_world_has_the_maps_of_the_mixture(tmp_path):
    smooth, raster = worlds_of(tmp_path, "worlds: {a: {}, b: {cell: 2.5}}")
    one, other = (world.scenario.problem(0, 4) for world in (smooth, raster))
    assert isinstance(other.pdm, RasterMap)
    np.testing.assert_array_equal(one.start, other.start)
    assert other.probability_in_area == pytest.approx(one.probability_in_area, rel=1e-3)
    assert upper_bound(other) == pytest.approx(upper_bound(one), rel=0.02)


def test_a_smooth_raster_is_smooth_and_contrasted(tmp_path):
    (world,) = worlds_of(tmp_path, "worlds: {a: {cell: 2, smoothness: 10, contrast: 1.2}}")
    log = np.log(world.scenario.problem(0, 0).pdm.probability)
    assert log.std() == pytest.approx(1.2)
    assert np.abs(np.diff(log, axis=0)).mean() < 0.3


def test_real_maps_are_a_world_each_and_missing_ones_are_said(tmp_path):
    mapping = pytest.importorskip("wisar_planner.pdm.gis")
    from wisar_planner.pdm.geodesy import GeoOrigin

    text = "worlds: {real: {maps: 'maps/*.geojson', disc: 40, steps: 5}}"
    (missing,) = worlds_of(tmp_path, text)
    assert missing.scenario is None
    assert "no file *.geojson in" in missing.missing
    problem = RandomMaps().problem(0, 0)
    (tmp_path / "maps").mkdir()
    for name in ("b", "a"):
        path = tmp_path / "maps" / f"{name}.geojson"
        mapping.save_mixture(path, problem.pdm, problem.area.polygon, GeoOrigin(56.0, -4.0))
    first, second = worlds_of(tmp_path, text)
    assert (first.name, second.name) == ("real a", "real b")
    assert isinstance(first.scenario, FixedMap)
    assert first.scenario.search_area.area == pytest.approx(np.pi * 40**2, rel=2e-3)
    assert first.scenario.problem(0, 0).steps == 5
    beside = shapely.box(260.0, 260.0, 300.0, 300.0)
    mapping.save_mixture(tmp_path / "c.geojson", problem.pdm, beside, GeoOrigin(56.0, -4.0))
    with pytest.raises(
        InvalidInput, match=r"'real': .*c\.geojson: its search area holds .* too lit"
    ):
        worlds_of(tmp_path, "worlds: {real: {maps: 'c.geojson', disc: 40, steps: 5}}")
    worlds_of(tmp_path, text)
    file = tmp_path / "worlds.yaml"
    assert chosen(file, "real") == ["real a", "real b"]
    assert chosen(file, "real b") == ["real b"]
    with pytest.raises(InvalidInput, match="two worlds are called 'real a'"):
        worlds_of(tmp_path, text.replace("}}", "}, real a: {}}"))


def test_what_is_wrong_with_a_map_is_said_with_its_world_and_file(tmp_path):
    mapping = pytest.importorskip("wisar_planner.pdm.gis")
    from wisar_planner.pdm.geodesy import GeoOrigin

    text = "worlds: {real: {maps: '*.geojson', disc: 40, steps: 5}}"
    path = tmp_path / "bent.geojson"
    # The middle of its bounds lies 50 m or more from this L.
    bent = shapely.box(0, 0, 150, 150).difference(shapely.box(20, 20, 150, 150))
    mapping.save_mixture(path, RandomMaps().problem(0, 0).pdm, bent, GeoOrigin(56.0, -4.0))
    with pytest.raises(InvalidInput, match=r"world 'real': disc: none of .*bent\.geojson .*40 m"):
        worlds_of(tmp_path, text)
    path.write_text("{")
    with pytest.raises(InvalidInput, match=r"world 'real': .*bent\.geojson"):
        worlds_of(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[1]", "worlds"),
        ("worlds: {}", "worlds"),
        ("worlds: {a: 3}", "'a'"),
        ("worlds: {a: {modes: 3}}", "modes"),
        ("worlds: {a: {steps: 0}}", "steps"),
        ("worlds: {a: {components: 1.5}}", "components"),
        ("worlds: {a: {side: -1}}", "side"),
        ("worlds: {a: {deviations: [4]}}", "deviations"),
        ("worlds: {a: {deviations: [4, 2]}}", "deviations"),
        ("worlds: {a: {smoothness: 4}}", "cell"),
        ("worlds: {a: {start: nowhere}}", "worlds.yaml: world 'a': start must be"),
        ("worlds: {'a, b': {}}", "world 'a, b': a comma"),
        ("worlds: {a: {step: 6, budget: 5}}", "world 'a': step: 6 m is longer than its budget"),
        ("worlds: {a: {maps: '*.tif', budget: 4, scale: 2}}", "world 'a': step: 16 m is longer"),
        ("worlds: {a: {", "YAML"),
    ],
)
def test_wrong_files_are_refused(tmp_path, text, named):
    with pytest.raises(InvalidInput, match=named):
        worlds_of(tmp_path, text)


FILE = "worlds: {short: {steps: 8}, raster: {steps: 8, cell: 5}, gone: {maps: none/*.tif}}"
SMALL = ["evaluate", "--planner", "lawnmower,lhc_gw_conv", "--persons", "5", "--jobs", "1"]


def untimed(path):
    results = json.loads(path.read_text())
    for world in results["worlds"].values():
        for planner in world.get("planners", {}).values():
            del planner["seconds_per_plan"]
    return results


def test_one_table_has_a_row_a_world_and_goes_on_where_it_stopped(tmp_path, capsys):
    file = tmp_path / "worlds.yaml"
    file.write_text(FILE)
    out, again, table = tmp_path / "out.json", tmp_path / "again.json", tmp_path / "table.md"
    command = [*SMALL, "--worlds", str(file), "--runs", "2"]
    assert main([*command, "--json", str(out), "--markdown", str(table)]) == 0
    rows = [line for line in table.read_text().splitlines() if line.startswith("|")]
    assert [row.split("|")[1].strip() for row in rows] == [
        "world", "---", "short", "raster", "gone",
    ]  # fmt: skip
    assert len({row.count("|") for row in rows}) == 1
    assert "skipped: no file *.tif" in rows[-1]
    assert rows[2] in capsys.readouterr().out
    short = json.loads(out.read_text())["worlds"]["short"]
    assert short["steps"] == 8
    assert short["reachable_bound"]["e_p_mean"] <= short["upper_bound"]["e_p_mean"]
    planner = short["planners"]["lhc_gw_conv"]
    low, high = planner["share_of_bound_ci"]
    assert low <= planner["share_of_bound"] <= high <= 1.0
    assert planner["share_of_reachable_bound"] >= planner["share_of_bound"]
    assert short["planners"]["lawnmower"]["share_of_reachable_bound"] is None
    (pair,) = short["comparisons"]
    first, second = (
        short["planners"][pair[name]]["share_of_bound"] for name in ("planner", "other")
    )
    assert pair["share_difference"] == pytest.approx(first - second)
    # Finished: the runs that were kept for continuing are gone.
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.json", "table.md", "worlds.yaml"]

    # Runs of a command with more of them stay.
    beside = tmp_path / "out.json.runs"
    more = [*SMALL, "--worlds", str(file), "--runs", "3", "--resume", str(beside)]
    assert main(more) == 0
    assert main([*command, "--world", "short", "--json", str(out)]) == 0
    assert len(list(beside.glob("*.jsonl"))) == 2
    assert "more runs, not in these results, are kept" in capsys.readouterr().err
    assert main([*command, "--json", str(out)]) == 0

    kept = tmp_path / "kept.v1.2"  # a folder may have a dot in its name
    kept.mkdir()
    resumed = [*command, "--resume", str(kept), "--json", str(again)]
    assert main([*resumed, "--world", "short"]) == 0
    assert len(list(kept.glob("*.jsonl"))) == 1
    assert main(resumed) == 0
    assert len(list(kept.glob("*.jsonl"))) == 2
    assert untimed(again) == untimed(out)


def test_a_policy_that_changes_between_worlds_gives_no_results(tmp_path, monkeypatch, capsys):
    path, out = tmp_path / "policy.safetensors", tmp_path / "out.json"
    policy = load_model(find_model("sac_plain"))
    save_model(path, policy.weights, policy.card)
    (tmp_path / "worlds.yaml").write_text(FILE)
    summarise = worlds_table.summarise_world

    def trained_on(*args, **options):
        other = {name: value + np.float32(0.01) for name, value in policy.weights.items()}
        save_model(path, other, policy.card)
        return summarise(*args, **options)

    monkeypatch.setattr(worlds_table, "summarise_world", trained_on)
    command = ["evaluate", "--planner", "sac", "--option", f"sac.model={path}", "--jobs", "1"]
    command += ["--worlds", str(tmp_path / "worlds.yaml"), "--persons", "5", "--runs", "1"]
    assert main([*command, "--json", str(out)]) == 2
    assert "a policy changed between two worlds" in capsys.readouterr().err
    assert not out.exists()


def test_the_last_planner_is_counted_ahead_where_it_is_more_than_chance():
    def world(low, high):
        planner = {"share_of_bound": 0.5, "seconds_per_plan": 1.0}
        return {
            "steps": 8,
            "upper_bound": {"e_p_mean": 0.5},
            "reachable_bound": {"e_p_mean": 0.5},
            "planners": {"greedy": planner, "sac": planner},
            "comparisons": [
                {"planner": "greedy", "other": "sac", "share_difference_ci": [low, high]}
            ],
        }

    ends = [(-0.2, -0.1), (-0.2, -0.01), (-0.1, 0.1), (0.1, 0.2), (None, None)]
    results = {
        "setup": {"planners": {"greedy": {}, "sac": {}}, "runs": 3, "seed": 0},
        "worlds": {
            **{f"world {k}": world(*each) for k, each in enumerate(ends)},
            "gone": {"skipped": "no file"},
        },
    }
    told = worlds_markdown(results).splitlines()[-1]
    assert told.startswith("sac against greedy")
    assert told.endswith("ahead in 2 of 5 worlds, behind in 1.")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--budget", "80"], "--budget"),
        (["--swath-radius", "2"], "--swath-radius"),
        (["--start", "peak"], "--start"),
        (["--world", "nowhere"], "nowhere"),
        (["--resume", "runs.jsonl"], "--resume"),
    ],
)
def test_what_does_not_go_with_worlds_is_refused(tmp_path, capsys, arguments, named):
    file = tmp_path / "worlds.yaml"
    file.write_text(FILE)
    assert main([*SMALL, "--worlds", str(file), *arguments]) == 2
    assert named in capsys.readouterr().err


def test_a_world_needs_a_file(capsys):
    assert main([*SMALL, "--world", "paper"]) == 2
    assert "--worlds" in capsys.readouterr().err
