"""Compiled kernels of the Gaussian mixture.

A component is a row ``(scale, mx, my, w11, w21, w22, steepness)``. The whitened coordinates of a
point are ``u = w11 (x - mx)`` and ``v = w21 (x - mx) + w22 (y - my)``; there the component is a
standard bivariate normal. `scale` is its weight, `steepness` its largest inverse standard
deviation, that is the most that whitening stretches a length.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray

# Gauss-Legendre rules of 3 to 10 nodes, one after the other, and the longest piece each takes for
# an error below 1e-13 of the piece's length times the peak (found by trial against 48 nodes over
# random pieces). The length is whitened, with 0.65 per radian of turn added for an arc.
_FEWEST = 3
_LONGEST = np.array([0.045, 0.17, 0.38, 0.65, 1.0, 1.35, 1.75, 2.15])
_RULES = [np.polynomial.legendre.leggauss(n) for n in range(_FEWEST, _FEWEST + len(_LONGEST))]
_NODES = np.concatenate([nodes for nodes, _ in _RULES])
_WEIGHTS = np.concatenate([weights for _, weights in _RULES])
_TURN = 0.65
_MOST = _FEWEST + len(_LONGEST) - 1

_ROOT_HALF = math.sqrt(0.5)
_INVERSE_ROOT_TAU = 1.0 / math.sqrt(2.0 * math.pi)
# Beyond so many standard deviations the density is below 1e-31 of its peak.
_FAR = 12.0


@njit(cache=True)
def density(points: FloatArray, components: FloatArray) -> FloatArray:
    """Return the density of the mixture at `points`, (N, 2)."""
    values = np.zeros(len(points))
    for k in range(len(components)):
        scale, mx, my, w11, w21, w22, _ = components[k]
        peak = scale * w11 * w22 / (2.0 * math.pi)
        for n in range(len(points)):
            dx, dy = points[n, 0] - mx, points[n, 1] - my
            u = w11 * dx
            v = w21 * dx + w22 * dy
            values[n] += peak * math.exp(-0.5 * (u * u + v * v))
    return values


@njit(cache=True)
def normal(values: FloatArray) -> FloatArray:
    """Return the standard normal's distribution function at `values`, (N, K)."""
    out = np.empty_like(values)
    for index, value in np.ndenumerate(values):
        out[index] = 0.5 * math.erfc(-_ROOT_HALF * value)
    return out


@njit(cache=True)
def integrate_boundary(
    pieces: FloatArray,
    owners: npt.NDArray[np.int64],
    count: int,
    components: FloatArray,
) -> FloatArray:
    r"""Return the probability of the mixture in each of `count` regions given by their boundaries.

    Green's theorem in whitened coordinates: the mass of a standard normal in a region is
    :math:`\oint \phi(v) (\Phi(u) - c) \, dv` along its boundary, for any constant c. With c = 1
    for a region right of the mean and c = 0 left of it, the integrand is as small as the density
    around the region, so that a region far out in a tail keeps its relative accuracy.
    """
    result = np.zeros(count)
    n_components = len(components)
    side = np.zeros((count, n_components))
    xs, ys = np.empty(_MOST), np.empty(_MOST)
    dxs, dys = np.empty(_MOST), np.empty(_MOST)
    near = np.empty(n_components, dtype=np.int64)

    for i in range(len(pieces)):
        x0, y0, a, b, radius = pieces[i]
        owner = owners[i]
        if radius > 0.0:
            turn = b_minus_a = b - a
            reach = radius
            length = radius * abs(turn)
            half_x, half_y, middle_x, middle_y = 0.0, 0.0, x0, y0
        else:
            turn = b_minus_a = 0.0
            half_x, half_y = 0.5 * (a - x0), 0.5 * (b - y0)
            middle_x, middle_y = x0 + half_x, y0 + half_y
            reach = math.sqrt(half_x * half_x + half_y * half_y)
            length = 2.0 * reach
        if length == 0.0:
            continue

        steepest = 0.0
        n_near = 0
        for k in range(n_components):
            _, mx, my, w11, w21, w22, steepness = components[k]
            dx, dy = middle_x - mx, middle_y - my
            if side[owner, k] == 0.0:
                side[owner, k] = 1.0 if dx >= 0.0 else -1.0
            if abs(w21 * dx + w22 * dy) < _FAR + reach * steepness:
                near[n_near] = k
                n_near += 1
                steepest = max(steepest, steepness)
        if n_near == 0:
            continue

        size = steepest * length + _TURN * abs(turn)
        panels = max(1, math.ceil(size / _LONGEST[-1]))
        size /= panels
        rule = 0
        while _LONGEST[rule] < size:
            rule += 1
        n_nodes = _FEWEST + rule
        first = (n_nodes * (n_nodes - 1) - _FEWEST * (_FEWEST - 1)) // 2

        total = 0.0
        for panel in range(panels):
            centre = (2.0 * panel + 1.0) / panels - 1.0
            for n in range(n_nodes):
                t = centre + _NODES[first + n] / panels
                weight = _WEIGHTS[first + n] / panels
                if radius > 0.0:
                    theta = a + 0.5 * b_minus_a * (1.0 + t)
                    cosine, sine = math.cos(theta), math.sin(theta)
                    xs[n] = x0 + radius * cosine
                    ys[n] = y0 + radius * sine
                    dxs[n] = -radius * sine * 0.5 * b_minus_a * weight
                    dys[n] = radius * cosine * 0.5 * b_minus_a * weight
                else:
                    xs[n] = middle_x + half_x * t
                    ys[n] = middle_y + half_y * t
                    dxs[n] = half_x * weight
                    dys[n] = half_y * weight
            for m in range(n_near):
                k = near[m]
                scale, mx, my, w11, w21, w22, _ = components[k]
                sign = side[owner, k]
                part = 0.0
                for n in range(n_nodes):
                    dx = xs[n] - mx
                    u = w11 * dx
                    v = w21 * dx + w22 * (ys[n] - my)
                    dv = w21 * dxs[n] + w22 * dys[n]
                    part += math.exp(-0.5 * v * v) * math.erfc(sign * u * _ROOT_HALF) * dv
                total -= 0.5 * _INVERSE_ROOT_TAU * scale * sign * part
        result[owner] += total
    return result


@njit(cache=True)
def cell_masses(x_edges: FloatArray, y_edges: FloatArray, components: FloatArray) -> FloatArray:
    """Return the probability in each cell of a grid, (rows, columns), for full covariances.

    Along y by Gauss-Legendre panels of at most 1 whitened length, along x in closed form: given y,
    x is normal, and a cell's mass is a difference of its distribution function.
    """
    rows, columns = len(y_edges) - 1, len(x_edges) - 1
    masses = np.zeros((rows, columns))
    n_nodes = 8
    first = (n_nodes * (n_nodes - 1) - _FEWEST * (_FEWEST - 1)) // 2
    for k in range(len(components)):
        scale, mx, my, w11, w21, w22, steepness = components[k]
        # Marginal of y, and x given y: mean mx + slope (y - my), inverse deviation `narrow`.
        norm = math.sqrt(w11 * w11 + w21 * w21)
        narrow = norm
        slope = -w21 * w22 / (norm * norm)
        wy = w11 * w22 / norm
        for row in range(rows):
            low, high = y_edges[row], y_edges[row + 1]
            panels = max(1, math.ceil((high - low) * steepness))
            half = 0.5 * (high - low) / panels
            for panel in range(panels):
                middle = low + (2 * panel + 1) * half
                for n in range(n_nodes):
                    dy = middle + half * _NODES[first + n] - my
                    factor = wy * dy
                    if abs(factor) > _FAR:
                        continue
                    factor = (
                        0.5
                        * scale
                        * wy
                        * _INVERSE_ROOT_TAU
                        * math.exp(-0.5 * factor * factor)
                        * half
                        * _WEIGHTS[first + n]
                    )
                    centre = mx + slope * dy
                    before = math.erf((x_edges[0] - centre) * narrow * _ROOT_HALF)
                    for column in range(columns):
                        after = math.erf((x_edges[column + 1] - centre) * narrow * _ROOT_HALF)
                        masses[row, column] += factor * (after - before)
                        before = after
    return masses


@njit(cache=True)
def cell_ranges(
    x0: float, y0: float, cell: float, covered: FloatArray, components: FloatArray
) -> FloatArray:
    """Return bounds of the density over the cells of a grid that are covered at all, (M, 4).

    A row is ``(low, high, mean, area)``: the density lies between `low` and `high` anywhere in the
    cell, its mean over the covered part, of `area` m^2, is at most `mean`. The bounds follow from
    value and gradient at the centre and from a bound of the curvature, which for a component is
    its peak density over its smallest variance.
    """
    rows, columns = covered.shape
    ranges = np.empty((rows * columns, 4))
    curvature = 0.0
    for k in range(len(components)):
        scale, _, _, w11, _, w22, steepness = components[k]
        curvature += scale * w11 * w22 / (2.0 * math.pi) * steepness * steepness
    used = 0
    for row in range(rows):
        y = y0 + (row + 0.5) * cell
        for column in range(columns):
            if covered[row, column] <= 0.0:
                continue
            x = x0 + (column + 0.5) * cell
            value, gx, gy = 0.0, 0.0, 0.0
            for k in range(len(components)):
                scale, mx, my, w11, w21, w22, _ = components[k]
                u = w11 * (x - mx)
                v = w21 * (x - mx) + w22 * (y - my)
                p = scale * w11 * w22 / (2.0 * math.pi) * math.exp(-0.5 * (u * u + v * v))
                value += p
                gx -= p * (u * w11 + v * w21)
                gy -= p * v * w22
            spread = 0.5 * cell * (abs(gx) + abs(gy))
            # Half the curvature times the squared distance: cell^2 / 2 at a corner, cell^2 / 6 on
            # average over the cell.
            bend = 0.25 * curvature * cell * cell
            high = value + spread + bend
            mean = value + bend / 3.0 if covered[row, column] >= 1.0 else high
            ranges[used, 0] = max(value - spread - bend, 0.0)
            ranges[used, 1] = high
            ranges[used, 2] = mean
            ranges[used, 3] = min(covered[row, column], 1.0) * cell * cell
            used += 1
    return ranges[:used]


@njit(cache=True)
def excess(ranges: FloatArray, level: float) -> tuple[float, float]:
    """Return upper bounds of the mass above a density level, and of the area above it.

    The mass above the level is the integral of ``max(p - level, 0)``. That is convex in p, so over
    a cell it is at most what the chord from its lowest to its highest value gives for the mean.
    """
    mass, area = 0.0, 0.0
    for m in range(len(ranges)):
        low, high, mean, cell_area = ranges[m]
        if high <= level:
            continue
        if low >= level:
            mass += (mean - level) * cell_area
            area += cell_area
        else:
            share = min((mean - low) / (high - low), 1.0)
            mass += share * (high - level) * cell_area
            area += share * cell_area
    return mass, area
