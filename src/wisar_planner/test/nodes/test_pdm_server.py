"""The map server in this process: what its service answers when something unforeseen fails."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy

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
