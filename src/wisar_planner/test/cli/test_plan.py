"""`wisar plan` from the command line's end: files, summary, and one line for a mistake."""

import importlib.util
import json
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import shapely

from wisar_planner.cli import plan as module
from wisar_planner.cli.main import main
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.pdm.gis import load_map, save_mixture
from wisar_planner.search import SearchPath

ORIGIN = GeoOrigin(56.77, -5.0)
DRONE = ("--budget", "300", "--swath-radius", "2.5", "--step", "8")
SARENV = Path(__file__).parents[5] / "shared" / "data" / "sarenv"
has_plan_files = pytest.mark.skipif(
    importlib.util.find_spec("wisar_planner.mavlink.files") is None,
    reason="no writers of plan files",
)


@pytest.fixture
def mixture_file(tmp_path):
    mixture = GaussianMixture(
        [0.6, 0.4], [[40.0, 60.0], [110.0, 90.0]], [500.0 * np.eye(2), 300.0 * np.eye(2)]
    )
    path = tmp_path / "map.yaml"
    save_mixture(path, mixture, shapely.box(0, 0, 150, 150), ORIGIN)
    return path


def demo_map(tmp_path):
    script = Path(__file__).parents[4] / "scripts" / "make_demo_map.py"
    spec = importlib.util.spec_from_file_location("make_demo_map", script)
    demo = importlib.util.module_from_spec(spec)
    # A dataclass looks its module up while it is being made.
    sys.modules[spec.name] = demo
    spec.loader.exec_module(demo)
    out = tmp_path / "new" / "glen.tif"
    assert demo.main(["--out", str(out), "--seed", "3"]) == 0
    return out


def refused(capsys, *arguments):
    """The one line that a mistake leaves on standard error."""
    try:
        status = main(["plan", *map(str, arguments)])
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def test_the_summary_says_what_was_achieved(mixture_file, capsys):
    assert main(["plan", str(mixture_file), *DRONE, "--planner", "expanding_square"]) == 0
    out = capsys.readouterr().out
    assert "expanding_square on" in out
    for part in ("e_p", "of the bound", "300 m of 300 m", "0.5 min at 10 m/s", "planned in"):
        assert part in out
    assert len(out.splitlines()) < 20


@has_plan_files
@pytest.mark.parametrize("suffix", [".geojson", ".plan", ".waypoints", ".kml", ".gpx"])
def test_a_plan_file_is_written_for_each_out(mixture_file, tmp_path, capsys, suffix):
    files = [tmp_path / f"one{suffix}", tmp_path / "sub" / f"two{suffix}"]
    outs = [part for file in files for part in ("--out", str(file))]
    assert main(["plan", str(mixture_file), *DRONE, "--planner", "sector", *outs]) == 0
    assert files[0].read_bytes() == files[1].read_bytes() != b""
    out = capsys.readouterr().out
    assert all(str(file) in out for file in files)


def test_the_summary_names_files_as_they_are_called(mixture_file, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = ["map[red]:boom:[/].yaml", "plan[bold].kml", "glen[/red] :boom: [b].plan", "[i].png"]
    Path(names[0]).parent.mkdir()
    mixture_file.rename(names[0])
    outs = ["--out", names[1], "--out", names[2], "--picture", names[3]]
    assert main(["plan", names[0], *DRONE, "--planner", "sector", *outs]) == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == f"sector on {names[0]}"
    written = [line.removeprefix("wrote").strip() for line in lines if line.startswith("wrote")]
    assert written == names[1:]
    assert all(Path(name).is_file() for name in names)


@pytest.fixture
def no_planning(monkeypatch):
    """What is refused must be so before the planning."""

    def plan(planner, problem, args):
        raise AssertionError("planned in vain")

    monkeypatch.setattr(module, "_plan", plan)


def area_file(path):
    """A GeoJSON file with a part of the mixture's area."""
    corners = LocalFrame(ORIGIN).to_geodetic([(9, 9), (99, 9), (99, 99), (9, 99), (9, 9)])
    path.write_text(json.dumps({"type": "Polygon", "coordinates": [corners[:, ::-1].tolist()]}))
    return path


def test_a_plan_never_overwrites_what_it_is_made_of(tmp_path, capsys, no_planning):
    drone = (*DRONE, "--planner", "sector")
    area = area_file(tmp_path / "area.geojson")
    map_file = tmp_path / "map.geojson"
    mixture = GaussianMixture([1.0], [[40.0, 60.0]], [500.0 * np.eye(2)])
    save_mixture(map_file, mixture, shapely.box(0, 0, 150, 150), ORIGIN)
    link, same = tmp_path / "link.geojson", tmp_path / "sub" / ".." / "map.geojson"
    link.symlink_to(area)
    (tmp_path / "sub").mkdir()
    before = area.read_bytes(), map_file.read_bytes()
    arguments = (map_file, "--area", area, *drone, "--out")
    for out in (map_file, same):
        assert "is the same file as the map; choose" in refused(capsys, *arguments, out)
    for out in (area, link):
        assert "is the same file as --area; choose" in refused(capsys, *arguments, out)
    twice = (tmp_path / "new.geojson", "--out", tmp_path / "sub" / ".." / "new.geojson")
    assert "is the same file as --out" in refused(capsys, *arguments, *twice)
    assert (area.read_bytes(), map_file.read_bytes()) == before
    assert not (tmp_path / "new.geojson").exists()


def test_a_hopeless_place_for_a_file_is_said_before_the_planning(
    mixture_file, tmp_path, capsys, no_planning
):
    arguments = (mixture_file, *DRONE, "--planner", "sector")
    folder, below = tmp_path / "folder.plan", mixture_file / "sub" / "plan.kml"
    folder.mkdir()
    assert "folder.plan is a folder; give" in refused(capsys, *arguments, "--out", folder)
    pictures = tmp_path / "p.png"
    pictures.mkdir()
    assert "p.png is a folder" in refused(capsys, *arguments, "--picture", pictures)
    assert "cannot be written (Not a directory)" in refused(capsys, *arguments, "--out", below)
    assert "cannot be written" in refused(capsys, *arguments, "--out", "/proc/plan.kml")
    missing = (tmp_path / "none.tif", *DRONE, "--planner", "sector")
    assert "no such file" in refused(capsys, *missing, "--out", tmp_path / "new" / "plan.kml")
    assert not (tmp_path / "new").exists()


def test_one_file_that_fails_does_not_cost_the_others(mixture_file, tmp_path, capsys):
    full, good, picture = (tmp_path / name for name in ("full.plan", "good.kml", "good.png"))
    full.symlink_to("/dev/full")
    outs = ["--out", str(full), "--out", str(good), "--picture", str(picture)]
    assert main(["plan", str(mixture_file), *DRONE, "--planner", "sector", *outs]) == 2
    captured = capsys.readouterr()
    assert len(captured.err.strip().splitlines()) == 1
    assert "full.plan was not written (No space left on device); make room" in captured.err
    assert "e_p" in captured.out
    assert str(good) in captured.out
    assert str(full) not in captured.out
    assert good.stat().st_size > 500
    assert picture.stat().st_size > 10_000


@has_plan_files
def test_the_geojson_is_the_path_in_degrees(mixture_file, tmp_path, monkeypatch):
    waypoints = np.array([[40.0, 60.0], [48.0, 60.0], [48.0, 68.0]])
    planned = SearchPath(waypoints, 2.5, "fixed")
    monkeypatch.setattr(module, "_plan", lambda planner, problem, args: planned)
    out = tmp_path / "plan.geojson"
    assert main(["plan", str(mixture_file), *DRONE, "--planner", "sector", "--out", str(out)]) == 0
    lines = [
        np.array(feature["geometry"]["coordinates"])[:, :2]
        for feature in json.loads(out.read_text())["features"]
        if feature["geometry"]["type"] == "LineString"
    ]
    expected = LocalFrame(ORIGIN).to_geodetic(waypoints)[:, ::-1]
    assert any(len(line) == 3 and np.allclose(line, expected, rtol=0, atol=1e-7) for line in lines)


def test_the_start_is_geodetic_and_in_the_middle_by_default(mixture_file, monkeypatch):
    problems = []

    def plan(planner, problem, args):
        problems.append(problem)
        return SearchPath(np.array([problem.start]), problem.swath_radius, "none")

    monkeypatch.setattr(module, "_plan", plan)
    ((latitude, longitude),) = LocalFrame(ORIGIN).to_geodetic([(30.0, 20.0)])
    arguments = ["plan", str(mixture_file), "--budget", "300", "--swath-radius", "2.5"]
    main([*arguments, "--planner", "sector", "--start", f"{latitude:.9f},{longitude:.9f}"])
    main([*arguments, "--planner", "sector"])
    assert problems[0].start == pytest.approx([30.0, 20.0], abs=1e-3)
    assert problems[1].start == pytest.approx([75.0, 75.0], abs=1e-3)
    assert problems[0].step_length == 5.0  # twice the swath radius


def test_a_raster_can_be_planned_as_a_mixture_and_is_judged_as_itself(
    tmp_path, capsys, monkeypatch
):
    seen = []
    plan = module._plan
    monkeypatch.setattr(
        module, "_plan", lambda planner, problem, args: (seen.append(problem.pdm), plan(
            planner, problem, args))[1],
    )  # fmt: skip
    glen, picture = demo_map(tmp_path), tmp_path / "glen.png"
    arguments = [
        "plan", str(glen), "--budget", "3000", "--swath-radius", "15",
        "--planner", "expanding_square",
    ]  # fmt: skip
    assert main([*arguments, "--mixture", "--picture", str(picture)]) == 0
    assert isinstance(seen[0], GaussianMixture)
    out = capsys.readouterr().out
    assert "planned on a mixture fitted to the raster" in out
    assert str(picture) in out
    assert picture.stat().st_size > 10_000
    assert main([*arguments, "--raster"]) == 0
    assert seen[1].probability.sum() == pytest.approx(1.0)


def test_an_area_file_bounds_the_search(mixture_file, tmp_path, monkeypatch):
    corners = LocalFrame(ORIGIN).to_geodetic(
        [(0.0, 0.0), (60.0, 0.0), (60.0, 80.0), (0.0, 80.0), (0.0, 0.0)]
    )
    area = tmp_path / "area.geojson"
    ring = corners[:, ::-1].tolist()
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    areas = []
    plan = module._plan

    def spy(planner, problem, args):
        areas.append(problem.area)
        return plan(planner, problem, args)

    monkeypatch.setattr(module, "_plan", spy)
    arguments = ["plan", str(mixture_file), *DRONE, "--planner", "lawnmower", "--area", str(area)]
    assert main(arguments) == 0
    assert areas[0].area == pytest.approx(4800.0, rel=1e-6)


def test_a_start_outside_is_answered_in_degrees(mixture_file, capsys):
    arguments = (mixture_file, *DRONE, "--planner", "sector")
    error = refused(capsys, *arguments, "--start", "56.8,-5.01")
    frame = LocalFrame(ORIGIN)
    (low, high) = frame.to_geodetic([(0.0, 0.0), (150.0, 150.0)])
    assert "56.8,-5.01 lies outside the search area" in error
    assert f"from {low[0]:.5f},{low[1]:.5f} to {high[0]:.5f},{high[1]:.5f}" in error
    assert "move it inside" in error
    ((latitude, longitude),) = frame.to_geodetic([(70.0, 70.0)])
    error = refused(capsys, *arguments, f"--start={longitude:.6f},{latitude:.6f}")
    assert f"the other way round it lies inside: --start={latitude:.6f}" in error


def test_a_start_with_a_longitude_for_its_latitude_is_understood(tmp_path, capsys):
    path, origin = tmp_path / "map.yaml", GeoOrigin(37.5, -122.3)
    mixture = GaussianMixture([1.0], [[40.0, 60.0]], [500.0 * np.eye(2)])
    save_mixture(path, mixture, shapely.box(0, 0, 150, 150), origin)
    error = refused(capsys, path, *DRONE, "--planner", "sector", "--start=-122.2995,37.5005")
    assert "latitude must lie between" in error
    assert "the other way round it lies inside: --start=37.5005,-122.2995" in error


def test_an_area_away_from_the_components_is_said_with_places(tmp_path, capsys):
    path = tmp_path / "map.yaml"
    mixture = GaussianMixture([1.0], [[40.0, 60.0]], [500.0 * np.eye(2)])
    save_mixture(path, mixture, shapely.box(20_000, 0, 20_150, 150), ORIGIN)
    error = refused(capsys, path, *DRONE, "--planner", "sector")
    assert "map.yaml: its search area lies around 56.7" in error
    assert "but its components around 56.770" in error


def test_a_step_longer_than_the_budget_is_refused(mixture_file, capsys, no_planning):
    long = ("--budget", "20", "--swath-radius", "2.5", "--step", "21")
    error = refused(capsys, mixture_file, *long, "--planner", "greedy")
    assert "--step: 21 m is longer than the --budget of 20 m" in error
    wide = ("--budget", "20", "--swath-radius", "11")
    error = refused(capsys, mixture_file, *wide, "--planner", "greedy")
    assert "by default twice --swath-radius: 22 m is longer" in error


def planned(monkeypatch, waypoints):
    """Let the planner answer with these waypoints."""
    path = SearchPath(np.array(waypoints, dtype=float), 2.5, "fixed")
    monkeypatch.setattr(module, "_plan", lambda planner, problem, args: path)


def summary(capsys, *arguments):
    assert main(["plan", *map(str, arguments), *DRONE, "--planner", "sector"]) == 0
    return " ".join(capsys.readouterr().out.split())


def test_an_efficiency_above_one_is_explained(tmp_path, mixture_file, capsys):
    note = "count what the swath sees beyond the border"
    assert note not in summary(capsys, mixture_file)
    path = tmp_path / "small.yaml"
    mixture = GaussianMixture([1.0], [[40.0, 60.0]], [500.0 * np.eye(2)])
    save_mixture(path, mixture, shapely.box(30, 50, 45, 65), ORIGIN)
    assert note in summary(capsys, path)


def test_files_with_heights_say_above_what(tmp_path, mixture_file, capsys):
    note = "heights in the files, 55 m, are above the launch point"
    assert note not in summary(capsys, mixture_file)
    assert note in summary(capsys, mixture_file, "--altitude", 55, "--out", tmp_path / "a.plan")


def test_what_of_the_path_lies_outside_is_said(mixture_file, capsys, monkeypatch):
    planned(monkeypatch, [(10, 10), (10, -20), (40, -20), (40, 20)])
    text = summary(capsys, mixture_file)
    assert "70 m of the path lie outside the area: the bound, of paths inside, does not" in text
    assert "% of the bound" not in text
    planned(monkeypatch, [(10, 10), (10, -0.0001), (11, 10)])
    assert "less than 0.1 m of the path lie outside the area" in summary(capsys, mixture_file)
    planned(monkeypatch, [(0, 0), (150, -1e-9), (150, 150)])
    text = summary(capsys, mixture_file)
    assert "outside" not in text
    assert "% of the bound" in text
    planned(monkeypatch, [(0, 0)])
    assert "outside" not in summary(capsys, mixture_file)


def test_parts_that_a_path_does_not_visit_are_named(tmp_path, capsys, monkeypatch):
    path = tmp_path / "parts.yaml"
    mixture = GaussianMixture(
        [0.6, 0.3, 0.1],
        [[50.0, 50.0], [350.0, 50.0], [350.0, 350.0]],
        [200.0 * np.eye(2)] * 3,
    )
    parts = [shapely.box(x, y, x + 100, y + 100) for x, y in ((0, 0), (300, 0), (300, 300))]
    save_mixture(path, mixture, shapely.MultiPolygon(parts), ORIGIN)
    planned(monkeypatch, [(50, 50), (80, 50)])
    text = summary(capsys, path)
    places = LocalFrame(ORIGIN).to_geodetic([(350, 50), (350, 350)])
    for (latitude, longitude), probability in zip(places, ("0.29", "0.09"), strict=True):
        assert f"around {latitude:.5f},{longitude:.5f} and with probability {probability}" in text
    assert "nothing of part 2 of 3" in text
    assert text.index("part 2 of 3") < text.index("part 3 of 3")
    assert text.count("plan it on its own") == 2
    planned(monkeypatch, [(50, 50), (350, 50), (350, 298)])  # 2 m from the last, seen
    assert "plan it on its own" not in summary(capsys, path)
    small = [shapely.box(320 + 6 * i, 0, 324 + 6 * i, 100) for i in range(8)]
    save_mixture(path, mixture, shapely.MultiPolygon([parts[0], *small]), ORIGIN)
    planned(monkeypatch, [(50, 50), (80, 50)])
    text = summary(capsys, path)
    assert text.count("plan it on its own") == 5
    assert "nor does it see anything of 3 more parts with probability 0.0" in text


class Stubborn:
    """A planner that thinks until it is told to stop."""

    name = "stubborn"

    def __init__(self, on_round):
        self.on_round = on_round

    def plan(self, problem, *, on_progress=None, should_stop=None):
        for i in range(10_000):
            self.on_round(i)
            if should_stop():
                return SearchPath(np.array([problem.start]), problem.swath_radius, self.name)
        raise AssertionError("was never stopped")


def test_the_time_budget_and_the_first_interrupt_end_the_planning(
    mixture_file, monkeypatch, capsys
):
    arguments = ["plan", str(mixture_file), *DRONE]
    slow = Stubborn(lambda i: time.sleep(0.001))
    monkeypatch.setattr(module, "_planner", lambda args: slow)
    assert main([*arguments, "--time-budget", "0.05"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "the --time-budget of 0.05 s was over with 0 m of the path's 300 m planned" in out
    interrupted = Stubborn(lambda i: signal.raise_signal(signal.SIGINT) if i == 3 else None)
    monkeypatch.setattr(module, "_planner", lambda args: interrupted)
    before = signal.getsignal(signal.SIGINT)
    assert main(arguments) == 0
    assert signal.getsignal(signal.SIGINT) is before
    twice = Stubborn(lambda i: signal.raise_signal(signal.SIGINT))
    twice.plan = lambda problem, **_: [twice.on_round(i) for i in range(3)]
    monkeypatch.setattr(module, "_planner", lambda args: twice)
    assert main(arguments) == 130
    assert "e_p" in capsys.readouterr().out


def test_mistakes_are_said_in_one_line(mixture_file, tmp_path, capsys):
    sector = (*DRONE, "--planner", "sector")
    assert "no such file" in refused(capsys, tmp_path / "none.tif", *sector).lower()
    assert "suffix" in refused(capsys, tmp_path / "map.shp", *sector)
    assert "--start: 'here'" in refused(capsys, mixture_file, *sector, "--start", "here")
    assert "latitude" in refused(capsys, mixture_file, *sector, "--start", "156,-5")
    assert "outside the search area" in refused(capsys, mixture_file, *sector, "--start", "56.8,-5")
    assert "no planner is called 'nobody'" in refused(
        capsys, mixture_file, *DRONE, "--planner", "nobody"
    )
    assert "option" in refused(capsys, mixture_file, *sector, "--option", "no_such=1")
    assert "name=value" in refused(capsys, mixture_file, *sector, "--option", "legs")
    assert "--out" in refused(capsys, mixture_file, *sector, "--out", tmp_path / "plan.doc")
    assert "--picture" in refused(capsys, mixture_file, *sector, "--picture", tmp_path / "a.doc")
    assert "--speed" in refused(capsys, mixture_file, *sector, "--speed", "0")
    assert "--time-budget" in refused(capsys, mixture_file, *sector, "--time-budget", "nan")
    assert "--budget" in refused(capsys, mixture_file, "--swath-radius", "3")
    endless = (*DRONE[2:], "--budget", "1e9", "--planner", "sector")
    assert "1e+09 m in steps of 8 m are 1.25e+08 steps, more than 200,000; give a longer --st" in (
        refused(capsys, mixture_file, *endless)
    )
    assert "not allowed with" in refused(capsys, mixture_file, *sector, "--mixture", "--raster")


def test_a_real_map(capsys):
    path = SARENV / "01.tif"
    if not path.exists():
        pytest.skip("the SAREnv maps are not here")
    ((latitude, longitude),) = load_map(path).frame.to_geodetic([(500.0, -500.0)])
    arguments = ["--budget", "10000", "--swath-radius", "33", "--step", "64"]
    start = f"{latitude:.6f},{longitude:.6f}"
    assert main(["plan", str(path), *arguments, "--planner", "sector", "--start", start]) == 0
    assert "EPSG:32630" in capsys.readouterr().out
