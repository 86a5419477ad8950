"""The map server node: from a map file to `pdm` and `pdm_grid`."""

from __future__ import annotations

import hashlib
import math
import sys
import threading
import traceback
from pathlib import Path

from nav_msgs.msg import OccupancyGrid
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from wisar_msgs.msg import ProbabilityMap
from wisar_msgs.srv import LoadPdm
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions, parameters
from wisar_planner.nodes.conversions import LocatedMap
from wisar_planner.nodes.qos import LATCHED
from wisar_planner.nodes.runtime import spin
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.fit import fit_mixture
from wisar_planner.pdm.gis import LoadedMap, load_map
from wisar_planner.search import SearchArea

GRID_CELLS = 200
"""Cells along the longer side of `pdm_grid` unless the parameter `grid_cell` is given."""


class PdmServer(Node):
    """Publishes a probability map read from a file, and replaces it on request.

    A raster is fitted by a Gaussian mixture, and the loss of the fit is logged. A file that
    cannot be used is refused with a text that says why; the published map stays.
    """

    def __init__(self) -> None:
        super().__init__("pdm_server")
        path = parameters.declare(
            self,
            "map",
            "",
            "Map to publish: a GeoTIFF, or a GeoJSON or YAML mixture; empty: wait for load_pdm",
            read_only=True,
        )
        parameters.declare(
            self,
            "area",
            "",
            "GeoJSON file with the search area; empty: the raster's footprint, the mixture's area",
        )
        parameters.declare(
            self,
            "components",
            0,
            "Normal distributions to fit to a raster; 0: chosen by the fit's criterion",
            minimum=0,
            maximum=64,
        )
        parameters.declare(
            self,
            "grid_cell",
            0.0,
            f"Cell of pdm_grid, m; 0: {GRID_CELLS} cells along the longer side",
            minimum=0.0,
        )
        parameters.declare(self, "seed", 0, "Seed of the fit", minimum=0)
        parameters.declare(self, "frame_id", "map", "Name of the local frame", read_only=True)
        self._loading = threading.Lock()
        self._map_publisher = self.create_publisher(ProbabilityMap, "pdm", LATCHED)
        self._grid_publisher = self.create_publisher(OccupancyGrid, "pdm_grid", LATCHED)
        if path:
            self._load(path, self.get_parameter("components").value)
        # Reading and fitting take seconds: in a group of its own, the node still answers.
        self.create_service(
            LoadPdm, "load_pdm", self._on_load, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def _on_load(self, request: LoadPdm.Request, response: LoadPdm.Response) -> LoadPdm.Response:
        try:
            located, text = self._load(
                request.path, int(request.components) or self.get_parameter("components").value
            )
        except (InvalidInput, OSError) as error:
            self.get_logger().error(f"{error}; the published map stays")
            response.success, response.message = False, str(error)
            return response
        except Exception as error:
            # A client without an answer waits for ever.
            self.get_logger().error(
                f"loading failed, the published map stays:\n{traceback.format_exc()}"
            )
            response.success = False
            response.message = f"loading failed: {type(error).__name__}: {error}"
            return response
        response.success, response.message, response.map_id = True, text, located.map_id
        return response

    def _load(self, path: str, components: int) -> tuple[LocatedMap, str]:
        """Read, fit and publish a map; return it and a text for people.

        Raises
        ------
        InvalidInput
            When the file cannot be used as a map, or `grid_cell` not for its area.
        OSError
            When it cannot be read.
        """
        with self._loading:
            loaded = load_map(path, area=self.get_parameter("area").value or None)
            mixture, fit_text = self._mixture(loaded, components)
            now = self.get_clock().now().nanoseconds
            located = LocatedMap(
                map_id=f"{Path(path).stem}-{_content_hash(Path(path))}-{now // 1_000_000:x}",
                pdm=mixture,
                area=SearchArea(loaded.area),
                origin=loaded.origin,
                stamp_ns=now,
                frame_id=self.get_parameter("frame_id").value,
                source=loaded.source,
            )
            self._publish(located)
        text = f"map {located.map_id}: {fit_text}"
        for note in (text, *loaded.notes):
            self.get_logger().info(note)
        return located, "; ".join((text, *loaded.notes))

    def _mixture(self, loaded: LoadedMap, components: int) -> tuple[GaussianMixture, str]:
        if isinstance(loaded.pdm, GaussianMixture):
            return loaded.pdm, f"mixture of {len(loaded.pdm.weights)} components"
        fit = fit_mixture(
            loaded.pdm, components=components or None, seed=self.get_parameter("seed").value
        )
        return fit.mixture, (
            f"raster fitted by {fit.components} components, "
            f"total variation distance {fit.total_variation:.3f}"
        )

    def _publish(self, located: LocatedMap) -> None:
        """Publish map and grid, both or, where the grid is refused, neither."""
        cell = self.get_parameter("grid_cell").value or _default_cell(located.area)
        header = conversions.header(located.stamp_ns, located.frame_id)
        message = conversions.map_to_msg(located)
        try:
            grid = conversions.grid_to_msg(located.pdm, located.area, cell, header)
        except InvalidInput as error:
            raise InvalidInput(f"parameter grid_cell: {error}") from None
        self._map_publisher.publish(message)
        self._grid_publisher.publish(grid)


def _default_cell(area: SearchArea) -> float:
    xmin, ymin, xmax, ymax = area.bounds
    return math.ceil(max(xmax - xmin, ymax - ymin) / GRID_CELLS * 100.0) / 100.0


def _content_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:8]


def main() -> int:
    """Run the node as a process."""
    return spin(PdmServer)


if __name__ == "__main__":
    sys.exit(main())
