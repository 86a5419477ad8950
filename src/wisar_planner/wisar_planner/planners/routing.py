"""Geometry of flight patterns: keep lines inside the area, join them, set waypoints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from wisar_planner.errors import FloatArray
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem

# Pieces and gaps shorter than this share of the area's extent are rounding.
_TINY = 1e-9
# Lines clipped at a time; a budget seldom needs all lines of a pattern.
_BATCH = 32


def clip_lines(polygon: Polygon | MultiPolygon, lines: FloatArray) -> Iterator[FloatArray]:
    """Yield what of each line lies inside the polygon, in the order of flight.

    Parameters
    ----------
    polygon : Polygon or MultiPolygon
        The search area.
    lines : (N, 2, 2) float64
        Start and end of each straight line, m.

    Yields
    ------
    (2, 2) float64
        Start and end of a piece; a line that crosses holes yields several.
    """
    tiny = _extent(polygon) * _TINY
    for first in range(0, len(lines), _BATCH):
        batch = lines[first : first + _BATCH]
        clipped = np.asarray(shapely.intersection(shapely.linestrings(batch), polygon))
        for line, inside in zip(batch, clipped, strict=True):
            yield from _pieces(line, inside, tiny)


def route(polygon: Polygon | MultiPolygon, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the way from `a` to `b` that stays inside the polygon: straight where it can be.

    Where the straight line leaves the polygon, it follows the border that it meets, the shorter
    way round. Between separate parts of the area it flies straight across.

    Parameters
    ----------
    polygon : Polygon or MultiPolygon
        The search area.
    a, b : (2,) float64
        Points inside the area or on its border, m.

    Returns
    -------
    (M, 2) float64
        Vertices from `a` to `b`, both included.
    """
    straight = np.stack([a, b])
    if not np.any(a != b) or polygon.covers(shapely.linestrings(straight)):
        return straight
    vertices = [a[None]]
    position = a
    for piece in [*clip_lines(polygon, straight[None]), np.stack([b, b])]:
        vertices += [_around(polygon, position, piece[0]), piece[1:]]
        position = piece[1]
    way = np.concatenate(vertices)
    moved = np.any(way[1:] != way[:-1], axis=1)
    return way[np.concatenate([[True], moved])]


def chain(
    polygon: Polygon | MultiPolygon, pieces: Iterable[FloatArray], limit: float
) -> FloatArray:
    """Return one polyline that flies the pieces in turn, joined by `route`.

    Parameters
    ----------
    polygon : Polygon or MultiPolygon
        The search area.
    pieces : iterable of (M, 2) float64
        Polylines inside the area; no more are taken than `limit` needs.
    limit : float
        Length in metres at which the polyline may end.
    """
    vertices: list[FloatArray] = []
    length = 0.0
    for piece in pieces:
        joined = piece
        if vertices:
            joined = np.concatenate([route(polygon, vertices[-1][-1], piece[0])[:-1], piece])
            length += float(np.hypot(*(joined[0] - vertices[-1][-1])))
        vertices.append(joined)
        length += float(np.hypot(*np.diff(joined, axis=0).T).sum())
        if length >= limit:
            break
    return np.concatenate(vertices)


def waypoints_along(polyline: FloatArray, spacing: float, limit: float) -> FloatArray:
    """Return waypoints on a polyline: its corners and, on each leg, one every `spacing` metres.

    Parameters
    ----------
    polyline : (M, 2) float64
        Vertices, m; repeated ones are dropped.
    spacing : float
        Distance between waypoints on a leg, m.
    limit : float
        Length in metres at which the polyline is cut.

    Returns
    -------
    (N, 2) float64
    """
    legs = np.hypot(*np.diff(polyline, axis=0).T)
    keep = np.concatenate([[True], legs > 1e-9 * spacing])
    polyline, legs = polyline[keep], legs[keep[1:]]
    ends = np.concatenate([[0.0], np.cumsum(legs)])
    # On each leg the distances 0, spacing, 2 spacing ... short of its end, then the last end.
    counts = np.maximum(1, np.ceil(legs / spacing - 1e-9).astype(np.int64))
    leg = np.repeat(np.arange(len(legs)), counts)
    along = (np.arange(len(leg)) - np.repeat(np.cumsum(counts) - counts, counts)) * spacing
    distances = np.append(ends[leg] + along, ends[-1])
    distances = np.append(distances[distances < limit * (1.0 - 1e-12)], min(limit, ends[-1]))
    if len(distances) > 1 and distances[-1] - distances[-2] <= 1e-9 * spacing:
        distances = np.delete(distances, -2)
    return np.stack([np.interp(distances, ends, polyline[:, axis]) for axis in (0, 1)], axis=-1)


def pattern_path(
    problem: SearchProblem, lines: FloatArray, planner: str, *, from_start: bool
) -> SearchPath:
    """Return the path that flies the lines of a pattern, as far as they lie inside the area.

    Parameters
    ----------
    problem : SearchProblem
        Supplies area, start, waypoint spacing and budget. No waypoint stands between parts of an
        area, and the path does not end there.
    lines : (N, 2, 2) float64
        Straight lines of the pattern in the order and direction of flight, m. They are clipped to
        the area and joined inside it.
    planner : str
        Name of the planner.
    from_start : bool
        Whether the leg from the start to the pattern's first point is flown and counted; else the
        path begins at that point.
    """
    polygon = problem.area.polygon
    limit = problem.max_distance
    pattern = chain(polygon, clip_lines(polygon, lines), limit)
    transit = 0.0
    if from_start:
        leg = route(polygon, problem.start, pattern[0])
        transit = min(limit, float(np.hypot(*np.diff(leg, axis=0).T).sum()))
        pattern = np.concatenate([leg, pattern])
    waypoints = waypoints_along(pattern, problem.step_length, limit)
    if isinstance(polygon, MultiPolygon):
        # Between parts it flies straight on, and where the budget ends there it is not begun.
        outside = shapely.distance(polygon, shapely.points(waypoints))
        waypoints = waypoints[outside <= _extent(polygon) * _TINY]
    return SearchPath(
        waypoints=waypoints,
        swath_radius=problem.swath_radius,
        planner=planner,
        transit_length=transit,
    )


def _pieces(line: FloatArray, inside: shapely.Geometry, tiny: float) -> list[FloatArray]:
    """Return the straight parts of what lies inside of a line, in its direction."""
    direction = line[1] - line[0]
    pieces = []
    for part in shapely.get_parts(inside):
        if part.is_empty:
            continue
        ends = shapely.get_coordinates(part)[[0, -1]]
        along = (ends - line[0]) @ direction
        ends = ends[np.argsort(along, kind="stable")]
        if np.hypot(*(ends[1] - ends[0])) > tiny:
            pieces.append((float(along.min()), ends))
    return [ends for _, ends in sorted(pieces, key=lambda piece: piece[0])]


def _around(polygon: Polygon | MultiPolygon, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the way from `a` to `b`, both on the border, along the ring that holds both."""
    tiny = _extent(polygon) * _TINY
    ends = shapely.points([a, b])
    if np.hypot(*(b - a)) <= tiny:
        return b[None]
    for ring in shapely.get_rings(shapely.get_parts(polygon)):
        if (shapely.distance(ring, ends) > tiny).any():
            continue
        first, last = (float(d) for d in shapely.line_locate_point(ring, ends))
        vertices = shapely.get_coordinates(ring)[:-1]
        at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices, axis=0).T))])
        forward = (last - first) % ring.length
        ahead = (at - first) % ring.length
        if forward <= ring.length / 2.0:
            passed = np.flatnonzero(ahead < forward)
            passed = passed[np.argsort(ahead[passed], kind="stable")]
        else:
            passed = np.flatnonzero(ahead > forward)
            passed = passed[np.argsort(-ahead[passed], kind="stable")]
        return np.concatenate([vertices[passed], b[None]])
    return b[None]


def _extent(polygon: Polygon | MultiPolygon) -> float:
    xmin, ymin, xmax, ymax = polygon.bounds
    return float(max(xmax - xmin, ymax - ymin, abs(xmin), abs(xmax), abs(ymin), abs(ymax)))
