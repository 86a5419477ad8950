"""The demo's map: the same for the same seed, and a probability map that loads."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

from wisar_planner.pdm.gis import load_map

SCRIPT = Path(__file__).parents[4] / "scripts" / "make_demo_map.py"


def make(path, seed):
    subprocess.run(
        [sys.executable, SCRIPT, "--out", path, "--seed", str(seed)],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return path


def test_the_demo_map_is_a_probability_map_that_its_seed_decides(tmp_path):
    one, again, other = (
        make(tmp_path / "new" / f"{name}.tif", seed)
        for name, seed in (("a", 0), ("b", 0), ("c", 1))
    )
    assert one.read_bytes() == again.read_bytes() != other.read_bytes()
    with rasterio.open(one) as dataset:
        values = dataset.read(1)
        assert dataset.crs.to_epsg() == 27700
        assert (dataset.res, values.shape, values.dtype) == ((10.0, 10.0), (150, 150), np.float32)
        known = np.array(dataset.tags()["LAST_KNOWN_POSITION"].split()[:2], dtype=float)
        row, column = dataset.index(*known)
    assert values.min() >= 0.0
    assert values.sum(dtype=float) == pytest.approx(1.0, abs=1e-6)
    # The hiker left the last known position, but most probably not far.
    near = values[max(row - 50, 0) : row + 50, max(column - 50, 0) : column + 50]
    assert near.sum() > 0.5
    assert values[row, column] < 0.2 * values.max()
    loaded = load_map(one)
    assert not any("sum to" in note for note in loaded.notes)
    # Upper Glen Nevis.
    assert loaded.origin.latitude == pytest.approx(56.774, abs=0.001)
    assert loaded.origin.longitude == pytest.approx(-5.0005, abs=0.001)
