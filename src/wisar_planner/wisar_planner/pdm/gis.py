"""Probability maps from files, whatever their format: the door to GeoTIFF, GeoJSON and YAML."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
import shapely

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.gaussian_mixture import GaussianMixture
from wisar_planner.pdm.geodesy import MAX_RADIUS, GeoOrigin
from wisar_planner.pdm.geojson import Area, load_area
from wisar_planner.pdm.loaded_map import LoadedMap

__all__ = ["LoadedMap", "load_map", "save_mixture"]

RASTER_SUFFIXES = (".tif", ".tiff")
GEOJSON_SUFFIXES = (".geojson", ".json")
YAML_SUFFIXES = (".yaml", ".yml")

_GEOJSON_HINT = (
    "origin is [longitude, latitude], and so is every position: check their order, and that all "
    "are of one search"
)
_YAML_HINT = "means are metres east and north of the origin, not coordinates of a grid such as UTM"

_NO_PROBABILITY = 1e-9
"""What is less is rounding, not a map."""

_SUSPICIOUS = 50_000.0
"""Metres from the origin beyond which no drone searches: more often a mistake than a map."""


def load_map(
    path: str | PathLike[str],
    *,
    band: int = 1,
    area: str | PathLike[str] | None = None,
    cell: float | None = None,
    origin: GeoOrigin | None = None,
) -> LoadedMap:
    """Read a probability map; the suffix of the file tells its format.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``: a raster in any CRS (`wisar_planner.pdm.geotiff`); ``.geojson`` or
        ``.json``, ``.yaml`` or ``.yml``: a Gaussian mixture (`wisar_planner.pdm.mixture_geojson`,
        `wisar_planner.pdm.mixture_yaml`).
    band : int
        Band of a raster, from 1.
    area : path-like, optional
        GeoJSON file (WGS84 degrees, RFC 7946) whose polygons are the search area, instead of the
        footprint of the raster or the area in the mixture's file.
    cell : float, optional
        Side of the cells of a raster map in metres; by default the raster's own, or a part of it
        where these are coarse (`wisar_planner.pdm.geotiff.load_geotiff`).
    origin : GeoOrigin, optional
        Where to measure local metres from; by default the centre of a raster, or what a mixture's
        file says. A YAML mixture is in metres and always has its own.

    Returns
    -------
    LoadedMap
        Map and search area in local metres, origin, and notes on what was done to the values.

    Raises
    ------
    InvalidInput
        If a file or an argument is wrong; the message names the file, the field and the remedy.
    OSError
        If a file cannot be read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (*GEOJSON_SUFFIXES, *YAML_SUFFIXES):
        for name, given in (("band", band != 1), ("cell", cell is not None)):
            if given:
                raise InvalidInput(
                    f"{name}: {path} is a mixture, only rasters have it; leave it out"
                )
    if suffix in RASTER_SUFFIXES:
        # Imported here: GDAL takes a second to load, and mixtures do not need it.
        from wisar_planner.pdm.geotiff import load_geotiff

        loaded = load_geotiff(path, band=band, cell=cell, origin=origin)
    elif suffix in GEOJSON_SUFFIXES:
        from wisar_planner.pdm.mixture_geojson import load_geojson_mixture

        loaded = _near(load_geojson_mixture(path, origin), _GEOJSON_HINT)
    elif suffix in YAML_SUFFIXES:
        from wisar_planner.pdm.mixture_yaml import load_yaml_mixture

        if origin is not None:
            raise InvalidInput(f"origin: {path} is in local metres and has its own; edit it there")
        loaded = _near(load_yaml_mixture(path), _YAML_HINT)
    else:
        raise InvalidInput(_unknown_suffix(path, RASTER_SUFFIXES))
    if area is None:
        return loaded
    return _within(loaded, Path(area))


def _near(loaded: LoadedMap, hint: str) -> LoadedMap:
    """Return a mixture that lies where its local frame is true; refuse another."""
    mixture = loaded.pdm
    if not isinstance(mixture, GaussianMixture):
        return loaded
    components = float(np.hypot(*mixture.means.T).max())
    for what, reach in (
        ("its components lie", components),
        ("its search area reaches", max(map(abs, loaded.area.bounds))),
    ):
        if reach > MAX_RADIUS:
            raise InvalidInput(
                f"{loaded.source}: {what} up to {reach / 1000:,.0f} km from its origin "
                f"{_degrees(loaded.origin)}, over {MAX_RADIUS / 1000:.0f} km; {hint}"
            )
    if components > _SUSPICIOUS:
        note = f"components lie up to {components / 1000:.0f} km from the origin"
        return replace(loaded, notes=(*loaded.notes, f"{note} {_degrees(loaded.origin)}"))
    return loaded


def _within(loaded: LoadedMap, path: Path) -> LoadedMap:
    """Return a map with the search area of a file, which must hold some of its probability."""
    area, notes = load_area(path, loaded.frame)
    if loaded.pdm.integrate(area) < _NO_PROBABILITY:
        if area.intersects(loaded.area):
            raise InvalidInput(
                f"{path}: holds no probability of {loaded.source}, whose values there are 0; "
                "draw the area where the map has some"
            )
        raise InvalidInput(
            f"{path}: lies around {_middle(area, loaded)}, but the map {loaded.source} around "
            f"{_middle(loaded.area, loaded)} (LAT,LON); {_remedy(area, loaded)}"
        )
    reach = max(map(abs, area.bounds))
    if reach > MAX_RADIUS:
        raise InvalidInput(
            f"{path}: reaches {reach / 1000:,.0f} km from the origin of {loaded.source}, over "
            f"{MAX_RADIUS / 1000:.0f} km; draw the search area closer"
        )
    return replace(loaded, area=area, notes=(*loaded.notes, *notes))


def _remedy(area: Area, loaded: LoadedMap) -> str:
    """Say why an area may lie apart from its map."""
    ((latitude, longitude),) = loaded.frame.to_geodetic(area.centroid.coords)
    if abs(longitude) <= 90.0:
        swapped = shapely.Point(loaded.frame.to_local(longitude, latitude)[0])
        if loaded.area.convex_hull.covers(swapped):
            return "with longitude and latitude swapped it lies on the map: swap them in the file"
    return "check that both are of the same search"


def _middle(area: Area, loaded: LoadedMap) -> str:
    ((latitude, longitude),) = loaded.frame.to_geodetic(area.centroid.coords)
    return _degrees(GeoOrigin(float(latitude), float(longitude)))


def _degrees(place: GeoOrigin) -> str:
    return f"{place.latitude:.5f},{place.longitude:.5f}"


def save_mixture(
    path: str | PathLike[str], mixture: GaussianMixture, area: Area, origin: GeoOrigin
) -> None:
    """Write a mixture and its search area so that `load_map` reads the same again.

    Parameters
    ----------
    path : path-like
        ``.geojson`` or ``.json`` for GIS programs (degrees), ``.yaml`` or ``.yml`` (metres).
    mixture : GaussianMixture
        In metres about `origin`.
    area : shapely.Polygon or shapely.MultiPolygon
        The search area in the same metres.
    origin : GeoOrigin
        Where (0, 0) is.

    Raises
    ------
    InvalidInput
        If the suffix is another.
    OSError
        If the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in GEOJSON_SUFFIXES:
        from wisar_planner.pdm.mixture_geojson import save_geojson_mixture

        save_geojson_mixture(path, mixture, area, origin)
    elif suffix in YAML_SUFFIXES:
        from wisar_planner.pdm.mixture_yaml import save_yaml_mixture

        save_yaml_mixture(path, mixture, area, origin)
    else:
        raise InvalidInput(_unknown_suffix(path, ()))


def _unknown_suffix(path: Path, rasters: tuple[str, ...]) -> str:
    known = ", ".join(rasters + GEOJSON_SUFFIXES + YAML_SUFFIXES)
    return f"{path}: the suffix {path.suffix!r} is not one of {known}"
