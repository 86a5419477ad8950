import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rasterio
import shapely

from wisar_planner.cli.evaluate import planner_specs
from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput

SMALL = ["evaluate", "--planner", "lawnmower,lhc_gw_conv", "--persons", "20", "--jobs", "1"]
SMALL += ["--budget", "80"]


def without_times(path):
    results = json.loads(path.read_text())
    for planner in results["planners"].values():
        del planner["seconds_per_plan"], planner["seconds_per_plan_p95"]
    return results


def test_everything_that_was_asked_for_is_written(tmp_path, capsys):
    paths = [tmp_path / "new" / name for name in ("out.json", "table.md", "figures")]
    arguments = ["--json", str(paths[0]), "--markdown", str(paths[1]), "--figures", str(paths[2])]
    assert main([*SMALL, "--runs", "3", "--seed", "4", *arguments]) == 0
    results = json.loads(paths[0].read_text())
    assert results["setup"]["seed"] == 4
    assert results["setup"]["max_distance_m"] == 80.0
    assert results["planners"]["lawnmower"]["runs"] == 3
    assert paths[1].read_text().startswith("| planner |")
    assert len(list(paths[2].glob("*.png"))) == 5
    assert "lhc_gw_conv" in capsys.readouterr().out
    # Finished: the runs that were kept for continuing are gone.
    assert sorted(p.name for p in paths[0].parent.iterdir()) == ["figures", "out.json", "table.md"]


def test_the_gap_is_written_where_it_is_asked_for(tmp_path, capsys):
    out, table = tmp_path / "out.json", tmp_path / "table.md"
    arguments = ["--runs", "2", "--gap", "--json", str(out), "--markdown", str(table)]
    assert main([*SMALL, *arguments]) == 0
    gap = json.loads(out.read_text())["gap"]["planners"]
    assert set(gap) == {"lawnmower", "lhc_gw_conv"}
    line = next(x for x in table.read_text().splitlines() if x.startswith("| planner | of bound"))
    assert line in capsys.readouterr().out


def test_resumed_file_is_kept_and_gives_the_same_numbers(tmp_path):
    runs = tmp_path / "runs.jsonl"
    outs = [tmp_path / f"{i}.json" for i in range(3)]
    assert main([*SMALL, "--runs", "2", "--resume", str(runs), "--json", str(outs[0])]) == 0
    assert main([*SMALL, "--runs", "4", "--resume", str(runs), "--json", str(outs[1])]) == 0
    assert main([*SMALL, "--runs", "4", "--json", str(outs[2])]) == 0
    assert without_times(outs[1]) == without_times(outs[2])
    assert runs.exists()
    assert main([*SMALL, "--runs", "2", "--seed", "1", "--resume", str(runs)]) == 2


@pytest.mark.parametrize("others", [["--gap"], ["--worlds", "worlds.yaml"]])
def test_no_process_is_refused_where_all_runs_are_stored_too(tmp_path, monkeypatch, capsys, others):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "worlds.yaml").write_text("worlds: {short: {steps: 8}}")
    small = ["evaluate", "--planner", "lawnmower", "--runs", "1", "--persons", "5"]
    command = [*small, *others, "--resume", str(tmp_path / "runs")]
    assert main([*command, "--jobs", "1"]) == 0
    capsys.readouterr()
    assert main([*command, "--jobs", "0"]) == 2
    assert "wisar: --jobs must be at least 1" in capsys.readouterr().err


def test_config_file_sets_the_scenario(tmp_path):
    config = tmp_path / "small.yaml"
    config.write_text(
        "/**: {ros__parameters: {area: [0, 0, 40, 30], components: 2, step_length: 4.0, "
        "covariance: [50, 10, 10, 40], swath_radius: 1.0, waypoints: 10}}"
    )
    out = tmp_path / "out.json"
    arguments = ["evaluate", "--planner", "lawnmower", "--runs", "2", "--jobs", "1"]
    assert main([*arguments, "--config", str(config), "--json", str(out)]) == 0
    setup = json.loads(out.read_text())["setup"]
    assert setup["area_m"] == [0.0, 0.0, 40.0, 30.0]
    assert setup["max_distance_m"] == 40.0
    assert setup["covariance_m2"] == [50.0, 10.0, 10.0, 40.0]


def test_a_map_from_a_file_is_searched(tmp_path):
    mapping = pytest.importorskip("wisar_planner.pdm.gis")
    from wisar_planner.evaluation.scenario import RandomMaps
    from wisar_planner.pdm.geodesy import GeoOrigin

    problem = RandomMaps().problem(0, 0)
    path, out = tmp_path / "map.geojson", tmp_path / "out.json"
    mapping.save_mixture(path, problem.pdm, problem.area.polygon, GeoOrigin(56.0, -4.0))
    arguments = ["--map", str(path), "--start", "centre", "--json", str(out), "--runs", "1"]
    assert main([*SMALL, *arguments]) == 2  # neither step nor swath radius
    assert main([*SMALL, *arguments, "--step", "8", "--swath-radius", "2.5"]) == 0
    setup = json.loads(out.read_text())["setup"]
    assert setup["maps"] == "map.geojson"
    assert setup["start"] == "centre"
    # The origin of the map is its corner (0, 0), some 110 m in latitude south of this point.
    arguments = ["--map", str(path), "--start", "56.001,-3.999", "--json", str(out), "--runs", "1"]
    assert main([*SMALL, *arguments, "--step", "8", "--swath-radius", "2.5"]) == 0
    x, y = map(float, json.loads(out.read_text())["setup"]["start"].split(","))
    assert (x, y) == pytest.approx((62.3, 111.3), abs=0.2)


def test_options_go_to_their_planner():
    specs = planner_specs(
        "lawnmower, lhc_gw_conv", ["lawnmower.lane_spacing=4", "lhc_gw_conv.levels=5"]
    )
    assert [(s.name, dict(s.options)) for s in specs] == [
        ("lawnmower", {"lane_spacing": 4}),
        ("lhc_gw_conv", {"levels": 5}),
    ]


@pytest.mark.parametrize(
    "wrong", ["lawnmower", "lanes=4", "greedy.headings=4", ".x=1", "lawnmower.=1"]
)
def test_wrong_options_are_refused(wrong):
    with pytest.raises(InvalidInput, match="--option"):
        planner_specs("lawnmower", [wrong])


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--planner", "nobody"], "nobody"),
        (["--planner", "lawnmower", "--runs", "0"], "runs"),
        (["--planner", "lawnmower", "--runs", "1", "--jobs", "0"], "jobs must be at least 1"),
        (["--planner", "lawnmower", "--step", "-1"], "step_length"),
        (["--planner", "lawnmower", "--step", "9", "--budget", "8"], "--step: 9 m is longer than"),
        (
            ["--planner", "lawnmower", "--budget", "5"],
            "by default that of the paper: 8 m is longer",
        ),
        (["--planner", "lawnmower", "--budget", "-5"], "max_distance"),
        (["--planner", "lawnmower", "--start", "1,2,3"], "start"),
        (["--planner", "lawnmower", "--start", "900,2"], "start"),
        (["--planner", "lawnmower", "--config", "missing.yaml"], "missing.yaml"),
        (["--planner", "lawnmower", "--json", "/proc/nowhere/out.json"], "/proc/nowhere"),
        (["--planner", "lawnmower", "--markdown", "/proc"], "is a folder"),
        (["--planner", "lawnmower", "--figures", "/dev/null/figures"], "--figures"),
        (["--planner", "lawnmower", "--json", "a.json", "--markdown", "./a.json"], "same file"),
        (["--planner", "lawnmower", "--map", "a.tif", "--json", "a.tif"], "same file"),
    ],
)
def test_mistakes_are_named_in_one_line(capsys, arguments, named):
    assert main(["evaluate", "--jobs", "1", *arguments]) == 2
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("wisar: ")]
    assert len(lines) == 1
    assert named in lines[0]


def test_ctrl_c_keeps_the_finished_runs_and_the_same_command_continues(tmp_path):
    out = tmp_path / "out.json"
    command = [sys.executable, "-m", "wisar_planner.cli", *SMALL, "--json", str(out)]
    kept = tmp_path / "out.json.runs.jsonl"
    child = subprocess.Popen(
        [*command, "--runs", "100000"], stderr=subprocess.PIPE, env={**os.environ}, text=True
    )
    deadline = time.monotonic() + 100.0
    while time.monotonic() < deadline and not (kept.exists() and kept.stat().st_size > 20_000):
        time.sleep(0.05)
    child.send_signal(signal.SIGINT)
    error = child.communicate(timeout=60)[1]
    assert child.returncode == 130, error
    assert "Traceback" not in error
    assert "continues from them" in error
    before = sum('"run"' in line for line in kept.read_text().splitlines())
    assert before > 0
    # Fewer runs, or other planners, do not cost what was kept.
    assert main([*SMALL, "--runs", "1", "--json", str(out)]) == 0
    assert sum('"run"' in line for line in kept.read_text().splitlines()) == before
    # Runs that are kept are not made again: one that is changed there is in the results.
    lines = kept.read_text().splitlines()
    maps = before // 2
    changed = next(i for i, line in enumerate(lines) if '"run"' in line)
    run = json.loads(lines[changed])
    run["run"]["seconds"] = 1e6
    kept.write_text("\n".join([*lines[:changed], json.dumps(run), *lines[changed + 1 :]]) + "\n")
    assert main([*SMALL, "--runs", str(maps + 3), "--json", str(out)]) == 0
    planners = json.loads(out.read_text())["planners"]
    assert planners[run["run"]["planner"]]["runs"] == maps + 3
    assert planners[run["run"]["planner"]]["seconds_per_plan"] > 1.0
    assert not kept.exists()


def test_runs_of_another_command_are_not_removed(tmp_path, capsys):
    """They are kept beside the results of one that finished: of other planners and more maps."""
    out, kept = tmp_path / "out.json", tmp_path / "out.json.runs.jsonl"
    assert main([*SMALL, "--runs", "3", "--resume", str(kept)]) == 0
    capsys.readouterr()
    fewer = ["--planner", "lawnmower", *SMALL[SMALL.index("--persons") :]]
    assert main(["evaluate", *fewer, "--runs", "2", "--json", str(out)]) == 0
    assert kept.exists()
    assert f"4 more runs, not in these results, are kept in {kept}" in capsys.readouterr().err


def test_an_area_beside_all_probability_is_refused(tmp_path, capsys):
    mapping = pytest.importorskip("wisar_planner.pdm.gis")
    from wisar_planner.evaluation.scenario import RandomMaps
    from wisar_planner.pdm.geodesy import GeoOrigin

    problem, path = RandomMaps().problem(0, 0), tmp_path / "map.geojson"
    beside = shapely.box(260.0, 260.0, 300.0, 300.0)
    mapping.save_mixture(path, problem.pdm, beside, GeoOrigin(56.0, -4.0))
    drone = ["--step", "8", "--swath-radius", "2.5"]
    assert main([*SMALL, "--map", str(path), *drone, "--runs", "1"]) == 2
    assert "of the probability, too little to draw" in capsys.readouterr().err


def test_notes_on_a_map_are_told(tmp_path, capsys):
    path = tmp_path / "map.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="float64", width=8, height=8, crs="EPSG:32630",
        transform=rasterio.transform.from_origin(377_000, 6_293_000, 10, 10),
    ) as dataset:  # fmt: skip
        dataset.write(np.full((8, 8), 0.5), 1)
    drone = ["--step", "8", "--swath-radius", "2.5"]
    assert main([*SMALL, "--map", str(path), *drone, "--runs", "1"]) == 0
    assert "values sum to 32: divided by it" in capsys.readouterr().err
