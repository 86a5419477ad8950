#!/usr/bin/env python3
"""Write the probability map of the demo: a hiker lost in a glen of the Scottish Highlands.

The place is real (upper Glen Nevis, British National Grid); terrain and statistics are
illustrative. The terrain is drawn from the seed: a glen with a burn at its bottom and a path
beside it, under rough slopes. The lost-person model follows the habits of the field: a ring of
distances from the last known position (lognormal), more probable along the way the hiker meant to
walk, near the path and along the burn, and less probable where the ground is steep.

    python scripts/make_demo_map.py --out out/demo/glen.tif --seed 0
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

Array = NDArray[np.float64]

CELLS = 150
CELL = 10.0  # metres
WEST, SOUTH = 216_000.0, 768_000.0  # EPSG:27700, metres

MEDIAN_DISTANCE = 500.0  # metres from the last known position, in a straight line
DISTANCE_SPREAD = 0.7  # standard deviation of the logarithm of that distance
WAY_AHEAD = np.radians(60.0)  # bearing of the intended way, up the glen
WAY_CONCENTRATION = 0.5  # von Mises: 0 would be no preference
PATH_WIDTH, PATH_PULL = 40.0, 4.0  # metres; how many times likelier at the path itself
BURN_WIDTH, BURN_PULL = 30.0, 5.0
STEEP = np.radians(35.0)  # slope at which the probability has fallen to 1/e


@dataclass(frozen=True)
class Terrain:
    """Cell by cell, row 0 in the south: metres to the burn and to the path, slope in radians."""

    to_burn: Array
    to_path: Array
    slope: Array


def make_terrain(east: Array, north: Array, rng: np.random.Generator) -> Terrain:
    """Draw a meandering glen that rises to the north-east, rough on its sides."""
    along, across = _turn(east, north)
    phases = rng.uniform(0.0, 2.0 * np.pi, size=3)
    burn = 70.0 * np.sin(along / 330.0 + phases[0]) + 25.0 * np.sin(along / 120.0 + phases[1])
    path = burn + 90.0 + 30.0 * np.sin(along / 260.0 + phases[2])
    to_burn, to_path = np.abs(across - burn), np.abs(across - path)
    sides = 260.0 * (1.0 - np.exp(-((to_burn / 320.0) ** 2)))
    height = 0.06 * along + sides + 45.0 * _rough(rng, scale=450.0)
    gradient = np.hypot(*np.gradient(height, CELL))
    return Terrain(to_burn, to_path, np.arctan(gradient))


def lost_person_probability(
    east: Array, north: Array, terrain: Terrain, last_known: Array
) -> Array:
    """Give the probability per cell, summing to 1, of where the hiker is."""
    x, y = east - last_known[0], north - last_known[1]
    distance = np.maximum(np.hypot(x, y), CELL / 2)
    bearing = np.arctan2(x, y)
    # The lognormal density of the distance, spread over the circle of that distance.
    deviation = np.log(distance / MEDIAN_DISTANCE) / DISTANCE_SPREAD
    ring = np.exp(-0.5 * deviation**2) / distance**2
    ahead = np.exp(WAY_CONCENTRATION * np.cos(bearing - WAY_AHEAD))
    near_path = 1.0 + (PATH_PULL - 1.0) * np.exp(-((terrain.to_path / PATH_WIDTH) ** 2))
    near_burn = 1.0 + (BURN_PULL - 1.0) * np.exp(-((terrain.to_burn / BURN_WIDTH) ** 2))
    walkable = np.exp(-((terrain.slope / STEEP) ** 2))
    weight = ring * ahead * near_path * near_burn * walkable
    probability: Array = weight / weight.sum()
    return probability


def make_map(seed: int) -> tuple[Array, Array]:
    """Give the probability (rows, columns), row 0 in the south, and the last known position."""
    rng = np.random.default_rng(seed)
    axis = (np.arange(CELLS) + 0.5) * CELL - CELLS * CELL / 2
    east, north = np.meshgrid(axis, axis)
    terrain = make_terrain(east, north, rng)
    # Last seen on the path, a third of the way up the glen.
    along, _ = _turn(east, north)
    row, column = np.unravel_index(
        np.argmin(terrain.to_path + np.abs(along + 230.0)), terrain.to_path.shape
    )
    last_known = np.array([axis[column], axis[row]])
    return lost_person_probability(east, north, terrain, last_known), last_known


def write_map(out: Path, seed: int) -> None:
    """Write the map of a seed as a GeoTIFF: one float32 band, probability per cell."""
    probability, last_known = make_map(seed)
    east, north = np.array([WEST, SOUTH]) + CELLS * CELL / 2 + last_known
    out.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(
        out,
        "w",
        driver="GTiff",
        width=CELLS,
        height=CELLS,
        count=1,
        dtype="float32",
        crs="EPSG:27700",
        transform=from_origin(WEST, SOUTH + CELLS * CELL, CELL, CELL),
        compress="deflate",
        predictor=3,
    ) as dataset:
        dataset.write(probability[::-1].astype("float32"), 1)
        dataset.set_band_description(1, "probability that the person is in the cell")
        dataset.update_tags(
            LAST_KNOWN_POSITION=f"{east:.0f} {north:.0f} EPSG:27700",
            SEED=str(seed),
            NOTE="synthetic terrain and illustrative statistics, for demonstration only",
        )


def _turn(east: Array, north: Array) -> tuple[Array, Array]:
    """Metres along the glen (towards the way ahead) and across it (to its left)."""
    sin, cos = np.sin(WAY_AHEAD), np.cos(WAY_AHEAD)
    return east * sin + north * cos, north * sin - east * cos


def _rough(rng: np.random.Generator, scale: float) -> Array:
    """Gaussian noise of unit variance with features of about ``scale`` metres and larger."""
    noise = np.fft.rfft2(rng.standard_normal((CELLS, CELLS)))
    fy, fx = np.fft.fftfreq(CELLS, CELL)[:, None], np.fft.rfftfreq(CELLS, CELL)[None, :]
    rough = np.fft.irfft2(noise / (1.0 + (scale * np.hypot(fx, fy)) ** 2) ** 2, (CELLS, CELLS))
    unit: Array = (rough - rough.mean()) / rough.std()
    return unit


def main(argv: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description="Write the demo's probability map: a hiker lost in a Highland glen (GeoTIFF)."
    )
    parser.add_argument("--out", type=Path, default=Path("out/demo/glen.tif"), metavar="FILE")
    parser.add_argument("--seed", type=int, default=0, help="of the terrain (default: 0)")
    arguments = parser.parse_args(argv)
    write_map(arguments.out, arguments.seed)
    print(f"{arguments.out}: {CELLS} x {CELLS} cells of {CELL:g} m, EPSG:27700")
    return 0


if __name__ == "__main__":
    sys.exit(main())
