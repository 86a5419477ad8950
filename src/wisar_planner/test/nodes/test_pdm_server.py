"""The map server in this process: what its service answers, and how maps are named."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rclpy
from rasterio.transform import from_origin
from rclpy.parameter import Parameter

from wisar_msgs.srv import LoadPdm
from wisar_planner.nodes import pdm_server


@pytest.fixture
def server() -> Iterator[pdm_server.PdmServer]:
    rclpy.init(args=[])
    node = pdm_server.PdmServer()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_load_pdm_answers_whatever_fails(server, monkeypatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError("no room for this raster")

    monkeypatch.setattr(pdm_server, "load_map", fail)
    answer = server._on_load(LoadPdm.Request(path="map.tif"), LoadPdm.Response())
    assert not answer.success
    assert "MemoryError: no room for this raster" in answer.message


def test_maps_of_other_contents_from_one_file_have_other_names(server, tmp_path: Path) -> None:
    raster = tmp_path / "raster.tif"
    rows, columns = np.mgrid[0:20, 0:20]
    values = np.exp(-((rows - 6) ** 2 + (columns - 8) ** 2) / 20.0) + np.exp(
        -((rows - 14) ** 2 + (columns - 13) ** 2) / 8.0
    )
    shape = {"width": 20, "height": 20, "count": 1, "dtype": "float32"}
    place = {"crs": "EPSG:4326", "transform": from_origin(-5.0, 56.8, 0.0002, 0.0001)}
    with rasterio.open(raster, "w", driver="GTiff", **shape, **place) as file:
        file.write(values.astype(np.float32), 1)
    area = tmp_path / "area.geojson"
    ring = [[-5, 56.798], [-4.997, 56.798], [-4.997, 56.8], [-5, 56.8], [-5, 56.798]]
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))

    def name(components: int) -> str:
        return server._read(str(raster), components).located.map_id

    assert name(1) == name(1)
    names = {name(1), name(2)}
    server.set_parameters([Parameter("area_file", value=str(area))])
    names |= {name(1), name(2)}
    assert len(names) == 4


def test_more_components_than_the_parameter_allows_are_refused(
    server, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(pdm_server, "load_map", lambda *_, **__: pytest.fail("read in vain"))
    most = server.describe_parameter("fit_components").integer_range[0].to_value
    for components in (most + 1, 2**32 - 1):
        request = LoadPdm.Request(path=str(tmp_path / "map.tif"), components=components)
        answer = server._on_load(request, LoadPdm.Response())
        assert not answer.success
        assert f"components must lie between 0 and {most}, not {components}" in answer.message


def test_the_parameter_says_how_many_components_where_a_request_does_not(server) -> None:
    assert server._components(LoadPdm.Request()) == 0
    server.set_parameters([Parameter("fit_components", value=3)])
    assert server._components(LoadPdm.Request()) == 3
    most = pdm_server.MOST_COMPONENTS
    assert server._components(LoadPdm.Request(components=most)) == most
