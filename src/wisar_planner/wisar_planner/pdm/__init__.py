"""Probability maps: where the missing person may be, as a probability density in metres."""

from wisar_planner.pdm.gaussian_mixture import GaussianMixture
from wisar_planner.pdm.grid import Grid
from wisar_planner.pdm.protocol import ProbabilityMap
from wisar_planner.pdm.raster_map import RasterMap

__all__ = ["GaussianMixture", "Grid", "ProbabilityMap", "RasterMap"]
