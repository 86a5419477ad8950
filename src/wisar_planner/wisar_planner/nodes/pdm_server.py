"""The map server node: from a map file to `pdm` and `pdm_grid`."""

from __future__ import annotations

import hashlib
import math
import sys
import threading
import traceback
from dataclasses import dataclass, replace
from pathlib import Path

import shapely
from nav_msgs.msg import OccupancyGrid
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
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
MOST_COMPONENTS = 64
"""Normal distributions that a raster is fitted by at most: a fit of many takes hours."""


@dataclass(frozen=True)
class _Draft:
    """A map that is ready but for its stamp, which completes its id; `notes` are for people."""

    located: LocatedMap
    grid: OccupancyGrid
    notes: tuple[str, ...]


class PdmServer(Node):
    """Publishes a probability map read from a file, and replaces it on request.

    A raster is fitted by a Gaussian mixture, and the loss of the fit is logged. A file that
    cannot be used is refused with a text that says why; the published map stays.

    With `use_sim_time` the map is published once the clock runs: stamps tell which of two maps is
    the newer one.
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
        # Not `area` and `components`: a file like config/paper.yaml gives all nodes under those
        # names what `wisar evaluate` draws its random maps from.
        parameters.declare(
            self,
            "area_file",
            "",
            "GeoJSON file with the search area; empty: the raster's footprint, the mixture's area",
        )
        parameters.declare(
            self,
            "fit_components",
            0,
            "Normal distributions to fit to a raster; 0: chosen by the fit's criterion",
            minimum=0,
            maximum=MOST_COMPONENTS,
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
        self._publishing = threading.RLock()  # stamps go out in their order
        self._map_publisher = self.create_publisher(ProbabilityMap, "pdm", LATCHED)
        self._grid_publisher = self.create_publisher(OccupancyGrid, "pdm_grid", LATCHED)
        self._waiting: _Draft | None = None  # for the clock
        if path:
            draft = self._read(path, self.get_parameter("fit_components").value)
            if self._clock_runs():
                self._publish(draft)
            else:
                self.get_logger().info(f"map {path} waits for /clock (use_sim_time)")
                self._waiting = draft
                self._waiter = self.create_timer(
                    0.05, self._on_wait, clock=Clock(clock_type=ClockType.STEADY_TIME)
                )
        # Reading and fitting take seconds: in a group of its own, the node still answers.
        self.create_service(
            LoadPdm, "load_pdm", self._on_load, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def _on_load(self, request: LoadPdm.Request, response: LoadPdm.Response) -> LoadPdm.Response:
        try:
            if not self._clock_runs():
                raise InvalidInput(
                    "nothing has come on /clock yet, and use_sim_time is set: a map without a "
                    "stamp cannot be told from an older one; start the simulator first"
                )
            draft = self._read(request.path, self._components(request))
            located = self._publish(draft)
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
        response.success, response.map_id = True, located.map_id
        response.message = "; ".join((f"map {located.map_id}", *draft.notes))
        return response

    def _components(self, request: LoadPdm.Request) -> int:
        """Return how many components to fit to a raster: the parameter's where none are asked for.

        Raises
        ------
        InvalidInput
            When there are more than the parameter allows.
        """
        if request.components > MOST_COMPONENTS:
            raise InvalidInput(
                f"components must lie between 0 and {MOST_COMPONENTS}, not {request.components}; "
                "give fewer, or 0 for the parameter fit_components"
            )
        return int(request.components) or int(self.get_parameter("fit_components").value)

    def _clock_runs(self) -> bool:
        """Return whether the time is known: simulated time is 0 until /clock tells it."""
        return self.get_clock().now().nanoseconds > 0

    def _on_wait(self) -> None:
        if self._clock_runs():
            self._waiter.cancel()
            with self._publishing:
                if self._waiting is not None:
                    self._publish(self._waiting)

    def _read(self, path: str, components: int) -> _Draft:
        """Read and fit a map, and draw its grid.

        Raises
        ------
        InvalidInput
            When the file cannot be used as a map, or `grid_cell` not for its area.
        OSError
            When it cannot be read.
        """
        loaded = load_map(path, area=self.get_parameter("area_file").value or None)
        mixture, fit_text = self._mixture(loaded, components)
        located = LocatedMap(
            map_id=f"{Path(path).stem}-{_content_hash(mixture, loaded)}",
            pdm=mixture,
            area=SearchArea(loaded.area),
            origin=loaded.origin,
            frame_id=self.get_parameter("frame_id").value,
            source=loaded.source,
        )
        # What every reader of the message would refuse is refused here, where somebody sees it.
        conversions.map_from_msg(conversions.map_to_msg(located))
        cell = self.get_parameter("grid_cell").value or _default_cell(located.area)
        header = conversions.header(0, located.frame_id)
        try:
            grid = conversions.grid_to_msg(mixture, located.area, cell, header)
        except InvalidInput as error:
            raise InvalidInput(f"parameter grid_cell: {error}") from None
        return _Draft(located, grid, (fit_text, *loaded.notes))

    def _publish(self, draft: _Draft) -> LocatedMap:
        """Stamp and publish map and grid; return the map as published."""
        with self._publishing:
            self._waiting = None  # an older map than this one
            now = self.get_clock().now().nanoseconds
            located = replace(
                draft.located,
                map_id=f"{draft.located.map_id}-{now // 1_000_000:x}",
                stamp_ns=now,
            )
            draft.grid.header = conversions.header(now, located.frame_id)
            draft.grid.info.map_load_time = draft.grid.header.stamp
            self._map_publisher.publish(conversions.map_to_msg(located))
            self._grid_publisher.publish(draft.grid)
        for note in (f"map {located.map_id}: {draft.notes[0]}", *draft.notes[1:]):
            self.get_logger().info(note)
        return located

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


def _default_cell(area: SearchArea) -> float:
    xmin, ymin, xmax, ymax = area.bounds
    return math.ceil(max(xmax - xmin, ymax - ymin) / GRID_CELLS * 100.0) / 100.0


def _content_hash(mixture: GaussianMixture, loaded: LoadedMap) -> str:
    """Return what tells maps apart that come from one file: fits and areas may differ."""
    content = hashlib.sha256()
    for values in (mixture.weights, mixture.means, mixture.covariances):
        content.update(values.tobytes())
    content.update(shapely.to_wkb(loaded.area))
    content.update(repr(loaded.origin).encode())
    return content.hexdigest()[:8]


def main() -> int:
    """Run the node as a process."""
    return spin(PdmServer)


if __name__ == "__main__":
    sys.exit(main())
