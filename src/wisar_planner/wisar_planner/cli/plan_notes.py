"""What the summary of `wisar plan` tells about a path beside its numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wisar_planner.pdm.geodesy import LocalFrame
    from wisar_planner.search import SearchPath, SearchProblem

_ALIKE = 5e-5  # what is less is not seen in four decimals
_MOST_PARTS = 5  # that are named one by one


def notes_on_path(
    problem: SearchProblem, path: SearchPath, frame: LocalFrame, scores: tuple[float, ...]
) -> list[str]:
    """Return what an operator must know about a path, one sentence each.

    Parameters
    ----------
    problem : SearchProblem
        What was asked for.
    path : SearchPath
        What was planned.
    frame : LocalFrame
        To name places in degrees.
    scores : tuple of float
        The efficiency and its bound.
    """
    from wisar_planner.search.bound import bound_holds, length_outside

    notes = []
    if max(scores) > 1.0 + _ALIKE:
        notes.append(
            "e_p and its bound count what the swath sees beyond the border of the area too, so "
            "that they may pass 1 where the area is small"
        )
    outside = length_outside(problem, path)
    if outside > 0.0:
        length = f"{outside:,.{1 if outside < 10.0 else 0}f} m"
        notes.append(
            f"{length if outside >= 0.05 else 'less than 0.1 m'} of the path lie outside the area"
            + ("" if bound_holds(problem, path) else ": the bound, of paths inside, does not hold")
        )
    return notes + _unseen_parts(problem, path, frame)


def _unseen_parts(problem: SearchProblem, path: SearchPath, frame: LocalFrame) -> list[str]:
    """Name the separate parts of the area of which a path sees nothing, the most probable first."""
    import numpy as np
    import shapely

    parts = shapely.get_parts(problem.area.polygon)
    points = path.waypoints
    line = shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0])
    unseen = np.flatnonzero(shapely.distance(parts, line) >= path.swath_radius)
    found = [(problem.pdm.integrate(parts[i]), int(i)) for i in unseen]
    found = sorted((pair for pair in found if pair[0] > _ALIKE), reverse=True)
    notes = []
    for probability, i in found[:_MOST_PARTS]:
        ((latitude, longitude),) = frame.to_geodetic(parts[i].representative_point().coords)
        notes.append(
            f"the path sees nothing of part {i + 1} of {len(parts)} of the area, around "
            f"{latitude:.5f},{longitude:.5f} and with probability {probability:.4f}: "
            "plan it on its own"
        )
    rest = found[_MOST_PARTS:]
    if rest:
        total = sum(probability for probability, _ in rest)
        notes.append(
            f"nor does it see anything of {len(rest)} more parts with probability {total:.4f}"
        )
    return notes
