"""Nodes that die and come back, maps that are replaced while the suite runs."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin

from wisar_msgs.srv import LoadPdm


def test_a_killed_planner_that_is_restarted_plans_again(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    first = suite.operator.plan
    suite.processes.kill("planner")
    suite.operator.plan = None
    suite.start_planner()
    suite.wait_for_plan()
    assert (suite.operator.plan.map_id, suite.operator.plan.x) == (first.map_id, first.x)


def test_a_killed_map_server_leaves_the_planner_working(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    suite.processes.kill("pdm_server")
    suite.operator.plan = None
    suite.start_map(mixture_file)
    suite.wait_for_plan()


def test_ctrl_c_in_flight_ends_every_node_in_order(suite, mixture_file) -> None:
    suite.start_autopilot()
    nodes = {
        "pdm_server": suite.start_map(mixture_file),
        "planner": suite.start_planner("sac_search"),
        "sim_drone": suite.start("wisar_sim", "sim_drone", tick_rate=20.0),
        "mavlink_bridge": suite.start_bridge(),
    }
    suite.wait(lambda: suite.operator.progress and suite.operator.progress.step > 0, "the flight")
    suite.wait_for_bridge()
    for process in nodes.values():
        process.send_signal(signal.SIGINT)
    assert {name: process.wait(30.0) for name, process in nodes.items()} == dict.fromkeys(nodes, 0)
    for name in nodes:
        assert not {"Traceback", "exception"} & set(suite.log(name).split()), suite.log(name)


def load(suite, path: Path):
    return suite.ask(LoadPdm, "load_pdm", LoadPdm.Request(path=str(path)))


def test_load_pdm_replaces_the_map_and_the_plan_follows(suite, mixture_file, write_mixture) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    first = suite.operator.plan
    answer = load(suite, write_mixture("moved.geojson", shift=150.0))
    assert answer.success, answer.message
    assert answer.map_id != first.map_id
    suite.wait(lambda: suite.operator.map.id == answer.map_id, "the new map")
    suite.wait(lambda: suite.operator.plan.map_id == answer.map_id, "the plan of the new map")


def test_load_pdm_takes_a_raster_in_degrees(suite, tmp_path) -> None:
    suite.start("wisar_planner", "pdm_server")
    path = tmp_path / "degrees.tif"
    rows, columns = np.mgrid[0:60, 0:60]
    values = np.exp(-((rows - 20) ** 2 + (columns - 35) ** 2) / 80.0).astype(np.float32)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=60,
        height=60,
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=from_origin(-5.0, 56.8, 0.0002, 0.0001),
    ) as raster:
        raster.write(values, 1)
    answer = load(suite, path)
    assert answer.success, answer.message
    assert "total variation" in answer.message
    suite.wait(lambda: suite.operator.map, "the map")
    origin = suite.operator.map.origin
    assert abs(origin.latitude - 56.797) < 1e-6
    assert abs(origin.longitude - -4.994) < 1e-6


def test_a_file_that_is_no_map_is_refused_and_the_map_stays(suite, mixture_file, tmp_path) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    good_map, good_plan = suite.operator.map, suite.operator.plan
    corrupt = tmp_path / "corrupt.tif"
    corrupt.write_bytes(b"II*\0 this is no raster")
    without_crs = tmp_path / "without_crs.tif"
    with rasterio.open(
        without_crs,
        "w",
        driver="GTiff",
        width=8,
        height=8,
        count=1,
        dtype="float32",
        transform=from_origin(0, 0, 10, 10),
    ) as raster:
        raster.write(np.ones((8, 8), np.float32), 1)
    nan_mixture = tmp_path / "nan.yaml"
    nan_mixture.write_text(mixture_file.read_text().replace("0.6", ".nan", 1))
    for path, words in (
        (tmp_path / "missing.tif", "missing.tif"),
        (corrupt, "corrupt.tif"),
        (without_crs, "coordinate reference system"),
        (nan_mixture, "nan.yaml"),
        (tmp_path / "map.docx", "map.docx"),
    ):
        answer = load(suite, path)
        assert not answer.success, path
        assert words in answer.message, answer.message
    assert "Traceback" not in suite.log("pdm_server")
    assert (suite.operator.map, suite.operator.plan) == (good_map, good_plan)


def test_a_grid_that_is_too_fine_is_refused_before_anything_is_published(
    suite, write_mixture
) -> None:
    suite.start("wisar_planner", "pdm_server", map=str(write_mixture("a.yaml")), grid_cell=1.0)
    suite.wait(lambda: suite.operator.map, "the map")
    good = suite.operator.map
    assert suite.set_parameter("grid_cell", 1e-6, "pdm_server").successful
    answer = load(suite, write_mixture("b.yaml", shift=50.0))
    assert not answer.success
    assert "grid_cell" in answer.message
    time.sleep(0.3)
    assert suite.operator.map == good
    assert "Traceback" not in suite.log("pdm_server")
    assert suite.set_parameter("grid_cell", 5.0, "pdm_server").successful
    assert load(suite, write_mixture("b.yaml", shift=50.0)).success


def test_a_map_server_with_a_wrong_map_ends_with_one_line(suite, tmp_path) -> None:
    process = suite.start_map(tmp_path / "nowhere.tif")
    assert process.wait(timeout=40) == 2
    assert len(suite.log("pdm_server").strip().splitlines()) == 1
    assert "nowhere.tif" in suite.log("pdm_server")
