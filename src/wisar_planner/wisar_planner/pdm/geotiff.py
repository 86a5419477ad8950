"""Probability maps from GeoTIFF files: checked, normalised and warped into local metres.

The value of a cell is taken as the weight of that cell: a probability, a score or, where cells are
equally large, a density. Cells without data (the file's nodata value or mask, and NaN) weigh
nothing. The warp keeps the mass: each source cell, a quadrilateral in the local frame, is split
among the local cells that it overlaps, by area. Where the source has few cells, or ones as coarse
would carry probability over the border of the raster, finer ones are taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
from rasterio.enums import ColorInterp
from rasterio.errors import RasterioError
from rasterio.transform import Affine
from shapely import Polygon

from wisar_planner.errors import FloatArray, InvalidInput, positive
from wisar_planner.pdm.geodesy import MAX_RADIUS, GeoOrigin, LocalFrame, origin_at
from wisar_planner.pdm.grid import Grid
from wisar_planner.pdm.loaded_map import LoadedMap
from wisar_planner.pdm.raster_map import RasterMap
from wisar_planner.pdm.warp_kernels import split_cells

MAX_CELLS = 50_000_000
"""Largest raster that is read or made; it bounds the memory of a load to about 2 GB."""

_MOST_LEAK = 0.01
"""Probability smeared over the border of the raster that is not worth a word."""

_CHEAP_CELLS = 40_000
"""Cells up to which each of the raster's own is made of parts in any case."""

_FINEST_CELLS = 4_000_000
"""Cells up to which finer ones are made to keep the probability within the raster's border."""

_COLOURS = (
    ColorInterp.red,
    ColorInterp.green,
    ColorInterp.blue,
    ColorInterp.alpha,
)

_BLOCK_ROWS = 512

_EDGE_POINTS = 65
"""Points along each side of the raster: a side that is straight there may be curved here."""


def load_geotiff(
    path: Path,
    *,
    band: int = 1,
    cell: float | None = None,
    origin: GeoOrigin | None = None,
) -> LoadedMap:
    """Read a probability map from a GeoTIFF in any CRS, north up or rotated.

    Parameters
    ----------
    path : Path
        The file.
    band : int
        Which band holds the map, from 1.
    cell : float, optional
        Side of the local cells in metres. By default the raster's own (the square root of the
        mean ground area of its cells) or, where these are few or would smear the probability over
        the raster's border, the half of it, a quarter and so on.
    origin : GeoOrigin, optional
        Where to measure local metres from; the centre of the raster by default.

    Returns
    -------
    LoadedMap
        A `RasterMap` whose mass is 1, and the footprint of the raster as its area. Local cells
        that the border of the footprint cuts hold a little mass beyond it; a note says so where
        it is more than a hundredth.

    Raises
    ------
    InvalidInput
        If the file is no GeoTIFF, is a picture, has no place on Earth, too many cells, a negative
        or infinite value, or no positive one.
    OSError
        If it cannot be read.
    """
    values, crs, transform, notes = _read(path, band)
    rows, columns = values.shape
    try:
        if origin is None:
            origin = origin_at(crs.to_wkt(), *_place(transform, columns / 2, rows / 2))
        frame = LocalFrame(origin)
        footprint = _footprint(rows, columns, crs, transform, frame)
    except (RasterioError, InvalidInput) as error:
        raise InvalidInput(
            f"{path}: its coordinates cannot be brought to latitude and longitude ({error}); "
            "check its CRS and geotransform with gdalinfo"
        ) from None
    reach = max(map(abs, footprint.bounds))
    if reach > MAX_RADIUS:
        raise InvalidInput(
            f"{path}: reaches {reach / 1000:.0f} km from its origin, over "
            f"{MAX_RADIUS / 1000:.0f} km; crop it to the search region (gdalwarp -te)"
        )
    peak = float(values.max())
    values /= peak  # so that no sum of finite values overflows
    share = math.fsum(values.sum(axis=1))
    if abs(peak * share - 1.0) > 1e-6:
        total = f"{peak * share:.6g}" if math.isfinite(peak * share) else "more than 1e308"
        notes.append(f"values sum to {total}: divided by it, so that they sum to 1")
    values /= share

    own_cell = math.sqrt(footprint.area / values.size)

    def warped(parts: int, side: float) -> RasterMap:
        # Cells aligned with the raster's own about its centre, so that a raster that is hardly
        # turned is hardly smeared.
        phase = (columns * parts % 2 / 2, rows * parts % 2 / 2)
        grid = _aligned_grid(footprint, side, phase, path)
        return RasterMap(_warp(values, crs, transform, frame, grid), grid)

    if cell is None:
        pdm, inside = _fine_enough(warped, values.size, own_cell, footprint)
    else:
        pdm = warped(1, positive(cell, "cell"))
        inside = pdm.integrate(footprint)
    if inside < 1.0 - _MOST_LEAK:
        notes.append(
            f"{inside:.3f} of the probability lies in the raster's footprint, the rest was smeared "
            "over its border: choose smaller cells"
        )
    side = pdm.grid.cell
    notes.append(f"{_name(crs)} warped to local cells of {side:.4g} m")
    return LoadedMap(
        pdm,
        shapely.simplify(footprint, side / 100.0),
        origin,
        str(path),
        tuple(notes),
    )


def _fine_enough(
    warped: Callable[[int, float], RasterMap], count: int, own_cell: float, footprint: Polygon
) -> tuple[RasterMap, float]:
    """Warp to cells that keep the probability within the border of the raster, but to few.

    Parameters
    ----------
    warped : callable
        Warps to cells of so many parts to a side of the raster's own, and so many metres.
    count : int
        Number of the raster's own cells.
    own_cell : float
        Side of the raster's own cells, m.
    footprint : Polygon
        The raster's outline, m.

    Returns
    -------
    pdm : RasterMap
        The map.
    inside : float
        The probability that it has in the footprint.
    """
    # Parts draw a turned or oblong cell truer, also along an area's border within the raster.
    parts = max(n for n in (1, 2, 4, 8) if n == 1 or count * n**2 <= _CHEAP_CELLS)
    while True:
        pdm = warped(parts, own_cell / parts)
        inside = pdm.integrate(footprint)
        # Cells of half the side smear half as much over the border.
        excess = (1.0 - inside) / (_MOST_LEAK / 2.0)
        room = _FINEST_CELLS / (pdm.grid.rows * pdm.grid.columns)
        if excess <= 1.0 or room < 4.0:
            return pdm, inside
        wanted, possible = math.ceil(math.log2(excess)), math.floor(math.log2(room) / 2.0)
        parts *= 2 ** min(wanted, possible)


def _read(path: Path, band: int) -> tuple[FloatArray, Any, Affine, list[str]]:
    """Return the weights (row 0 in the north or wherever the file has it), CRS and transform."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with rasterio.open(path, driver="GTiff") as dataset:
            _check_dataset(dataset, path, band)
            notes = [f"band {band} of {dataset.count}"] if dataset.count > 1 else []
            raw = dataset.read(band)
            seen = dataset.read_masks(band) > 0
            scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
            crs, transform = dataset.crs, dataset.transform
    except RasterioError as error:
        raise InvalidInput(
            f"{path}: not a readable GeoTIFF ({error}); check it with gdalinfo, export it again"
        ) from None
    with np.errstate(over="ignore"):  # what overflows is infinite, and refused below
        values = raw.astype(np.float64) * scale + offset
    missing = ~seen | np.isnan(values)
    values[missing] = 0.0
    if missing.any():
        count = int(missing.sum())
        notes.append(f"{count} cells without data ({count / values.size:.1%}): probability 0")
    _check_values(values, raw, path)
    return values, crs, transform, notes


def _check_dataset(dataset: Any, path: Path, band: int) -> None:
    if not 1 <= band <= dataset.count:
        raise InvalidInput(f"{path}: has no band {band}; choose one of 1 to {dataset.count}")
    if dataset.crs is None:
        raise InvalidInput(
            f"{path}: has no coordinate reference system; if you know it, write it into the "
            f"file, for UTM zone 30N: gdal_edit.py -a_srs EPSG:32630 {path.name}"
        )
    if dataset.transform == Affine.identity() or dataset.transform.determinant == 0.0:
        raise InvalidInput(
            f"{path}: has no geotransform, so its place is not known; export it again as a "
            "georeferenced GeoTIFF, or set its corners: gdal_edit.py -a_ullr XMIN YMAX XMAX YMIN"
        )
    if dataset.width * dataset.height > MAX_CELLS:
        raise InvalidInput(
            f"{path}: {dataset.width} x {dataset.height} cells are over {MAX_CELLS:.0e}; crop it "
            "(gdalwarp -te) or make its cells larger (gdalwarp -r sum -tr)"
        )
    if "complex" in dataset.dtypes[band - 1]:
        raise InvalidInput(f"{path}: band {band} holds complex numbers; choose a real band")
    _check_colours(dataset, path, band)


def _check_colours(dataset: Any, path: Path, band: int) -> None:
    """Refuse a picture: a colour is no probability, and in most pictures nothing is white, 255."""
    refusal = f"{path}: band {band} holds %s, so this is a picture of a map; export the raw values"
    if _has_colour_table(dataset, band):
        raise InvalidInput(f"{refusal % 'a palette of colours'}, without a colour table")
    colour = dataset.colorinterp[band - 1]
    if colour in _COLOURS:
        raise InvalidInput(
            f"{refusal % f'the {colour.name} channel'} (in QGIS: Save As, Raw data); if it does "
            f"hold probabilities: gdal_edit.py -colorinterp_{band} undefined {path.name}"
        )


def _has_colour_table(dataset: Any, band: int) -> bool:
    try:
        return bool(dataset.colormap(band))
    except ValueError:  # how rasterio says that there is none
        return False


def _check_values(values: FloatArray, raw: Any, path: Path) -> None:
    if np.isinf(values).any():
        raise InvalidInput(
            f"{path}: {int(np.isinf(values).sum())} values are infinite; replace them, "
            "or declare them as nodata: gdal_edit.py -a_nodata inf"
        )
    negative = values < 0.0
    if negative.any():
        lowest = float(values.min())
        # To the last digit and as it is stored, before scale and offset: GDAL compares with it.
        stored = raw.flat[int(values.argmin())].item()
        marker = f"{stored:.0f}" if float(stored).is_integer() else repr(stored)
        raise InvalidInput(
            f"{path}: {int(negative.sum())} values are negative (lowest {lowest:g}), which no "
            f"probability is; if it marks missing data: gdal_edit.py -a_nodata {marker} "
            f"{path.name}"
        )
    if not values.any():
        raise InvalidInput(f"{path}: all values are 0; a probability map needs a positive one")


def _place(transform: Affine, column: Any, row: Any) -> FloatArray:
    """Return x and y in the CRS of places counted in cells from the first corner of the file."""
    a, b, c, d, e, f = transform[:6]
    return np.array([a * column + b * row + c, d * column + e * row + f])


def _footprint(rows: int, columns: int, crs: Any, transform: Affine, frame: LocalFrame) -> Polygon:
    """Return the outline of the raster in local metres."""
    side = np.linspace(0.0, 1.0, _EDGE_POINTS)[:-1]
    zero, one = np.zeros_like(side), np.ones_like(side)
    u = columns * np.concatenate((side, one, 1.0 - side, zero))
    v = rows * np.concatenate((zero, side, one, 1.0 - side))
    x, y = _place(transform, u, v)
    outline = Polygon(frame.project(crs.to_wkt(), x, y))
    if not (outline.is_valid and outline.area > 0.0):
        raise InvalidInput("its outline folds over itself on the ground")
    return outline


def _aligned_grid(footprint: Polygon, cell: float, phase: tuple[float, float], path: Path) -> Grid:
    """Return a grid over the footprint with cell borders at ``(k + phase) * cell``."""
    margin = 1e-3 * cell  # for the bulge of a side between the points of the outline
    xmin, ymin, xmax, ymax = footprint.buffer(margin).bounds
    x0 = (math.floor(xmin / cell - phase[0]) + phase[0]) * cell
    y0 = (math.floor(ymin / cell - phase[1]) + phase[1]) * cell
    count = (xmax - x0) / cell * (ymax - y0) / cell
    if count > MAX_CELLS:
        raise InvalidInput(
            f"cell: {cell:g} m over {path} makes {count:.2g} cells, over {MAX_CELLS:.0e}; "
            "choose a larger one"
        )
    return Grid.covering((x0, y0, xmax, ymax), cell)


def _warp(
    probability: FloatArray, crs: Any, transform: Affine, frame: LocalFrame, grid: Grid
) -> FloatArray:
    """Split the mass of each source cell among the cells of a local grid, by area."""
    warped = np.zeros((grid.rows, grid.columns))
    columns = np.arange(probability.shape[1] + 1.0)
    wkt = crs.to_wkt()
    # In blocks of rows, so that the corners of a large raster need not be held all at once.
    for first in range(0, len(probability), _BLOCK_ROWS):
        block = probability[first : first + _BLOCK_ROWS]
        rows = first + np.arange(len(block) + 1.0)
        x, y = _place(transform, columns[None, :], rows[:, None])
        corners = frame.project(wkt, x.ravel(), y.ravel()).reshape(len(rows), len(columns), 2)
        split_cells((corners - (grid.x0, grid.y0)) / grid.cell, block, warped)
    return warped


def _name(crs: Any) -> str:
    epsg = crs.to_epsg(confidence_threshold=100)  # no other that only resembles it
    return f"EPSG:{epsg}" if epsg else str(crs.to_string())[:60]
