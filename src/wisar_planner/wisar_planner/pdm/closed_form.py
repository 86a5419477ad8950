"""The probability of a Gaussian mixture in a polygon, in closed form."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import owens_t
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray
from wisar_planner.pdm.boundary import polygon_edges
from wisar_planner.pdm.gaussian_mixture import GaussianMixture


def mixture_in_polygon(mixture: GaussianMixture, polygon: Polygon | MultiPolygon) -> float:
    r"""Return the probability of `mixture` inside `polygon` as a sum over its edges.

    Whitening turns a component into the standard bivariate normal. The polygon is then the signed
    sum of the triangles between the mean and each edge, and a triangle whose edge lies on a line
    at the distance h from the mean, from the offset :math:`t_0` to :math:`t_1` from the foot of
    the perpendicular, holds :math:`g(t_1) - g(t_0)` with

    .. math:: g(t) = \frac{1}{2 \pi} \arctan \frac{t}{h} - T(h, t / h),

    where T is Owen's function [1]_.

    Parameters
    ----------
    mixture : GaussianMixture
        Any number of components, full covariances.
    polygon : shapely.Polygon or shapely.MultiPolygon
        Holes and several parts allowed, m.

    Returns
    -------
    float
        Exact to about 1e-15 for each edge and component.

    Raises
    ------
    InvalidInput
        When `polygon` is no valid polygon.

    References
    ----------
    .. [1] D. B. Owen, "Tables for computing bivariate normal probabilities", Annals of
       Mathematical Statistics 27 (1956) 1075-1090.
    """
    edges = polygon_edges(polygon)
    total = 0.0
    for weight, mean, covariance in zip(
        mixture.weights, mixture.means, mixture.covariances, strict=True
    ):
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        start = (edges[:, 0:2] - mean) @ whitening.T
        end = (edges[:, 2:4] - mean) @ whitening.T
        total += float(weight) * float(np.sum(_triangles(start, end)))
    return total


def _triangles(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the standard normal probability of the triangles (0, start, end), signed, (N,)."""
    along = end - start
    length = np.hypot(along[:, 0], along[:, 1])
    along = along / np.where(length > 0.0, length, 1.0)[:, None]
    # Signed distance of the mean to the left of the edge.
    h = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    masses = np.zeros(len(start))
    off_line = h != 0.0  # An edge in line with the mean spans no triangle.
    distance = np.abs(h[off_line])
    for sign, point in ((1.0, end), (-1.0, start)):
        offset = np.einsum("ni,ni->n", point, along)[off_line]
        slope = offset / distance
        wedge = np.arctan2(offset, distance) / (2.0 * math.pi) - owens_t(distance, slope)
        masses[off_line] += sign * np.sign(h[off_line]) * wedge
    return masses
