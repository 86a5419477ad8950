"""A probability map that came from a file, with its place on Earth."""

from __future__ import annotations

from dataclasses import dataclass

from shapely import MultiPolygon, Polygon

from wisar_planner.pdm.gaussian_mixture import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.pdm.raster_map import RasterMap


@dataclass(frozen=True)
class LoadedMap:
    """A probability map in local metres, and what is needed to find it on Earth again.

    Parameters
    ----------
    pdm : RasterMap or GaussianMixture
        The map, in metres east and north of `origin`.
    area : shapely.Polygon or shapely.MultiPolygon
        The search area, in the same metres.
    origin : GeoOrigin
        Where (0, 0) is.
    source : str
        The file that the map was read from.
    notes : tuple of str
        What was done to the values on the way, one sentence each, for the operator.
    """

    pdm: RasterMap | GaussianMixture
    area: Polygon | MultiPolygon
    origin: GeoOrigin
    source: str
    notes: tuple[str, ...] = ()

    @property
    def frame(self) -> LocalFrame:
        """The local frame of the map and the area."""
        return LocalFrame(self.origin)
