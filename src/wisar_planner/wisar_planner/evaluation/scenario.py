"""What is evaluated: where maps and starts come from, and what the drone can do.

A scenario turns ``(seed, index)`` into a search problem. Runs differ by map and start in
`RandomMaps`, the paper's experiment, and by start alone in `FixedMap`, a map from a GIS.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from wisar_planner.errors import FloatArray, InvalidInput, finite_array
from wisar_planner.evaluation.streams import Facet, stream
from wisar_planner.pdm import GaussianMixture, Grid, ProbabilityMap
from wisar_planner.planners.datum import most_probable_point
from wisar_planner.search import SearchArea, SearchProblem
from wisar_planner.yaml_files import read_yaml

#: Where a run starts: "uniform" in the area, the most probable cell ("peak"), the area's middle
#: ("centre"), or a point in metres.
StartRule = str | tuple[float, float]
START_RULES = ("uniform", "peak", "centre")

_PAPER_AREA = (0.0, 0.0, 150.0, 150.0)
_PAPER_COVARIANCE = (500.0, 0.0, 0.0, 500.0)


@dataclass(frozen=True)
class Drone:
    """What the drone can do; the defaults are the paper's.

    Parameters
    ----------
    step_length : float
        Distance between waypoints, m.
    swath_radius : float
        Half the width of the strip that is seen, m.
    max_distance : float
        Longest path, m.
    """

    step_length: float = 8.0
    swath_radius: float = 2.5
    max_distance: float = 512.0

    def check_step_fits(self, step: str, budget: str) -> None:
        """Refuse a step that is longer than the longest path.

        Parameters
        ----------
        step, budget : str
            What the user calls the two.

        Raises
        ------
        InvalidInput
            If not one step can be flown.
        """
        # A budget that is not positive is a mistake of another kind, which the problem tells.
        if 0.0 < self.max_distance < self.step_length:
            raise InvalidInput(
                f"{step}: {self.step_length:g} m is longer than {budget} of "
                f"{self.max_distance:g} m, so that not one step can be flown; "
                "give a shorter step or a larger budget"
            )

    def description(self) -> dict[str, Any]:
        """Return the values for reports and for telling setups apart."""
        return {
            "step_length_m": self.step_length,
            "swath_radius_m": self.swath_radius,
            "max_distance_m": self.max_distance,
        }


class Scenario(Protocol):
    """A family of search problems, one per seed and index."""

    @property
    def drone(self) -> Drone:
        """What the drone can do, the same in all runs."""

    def problem(self, seed: int, index: int) -> SearchProblem:
        """Return problem `index` of `seed`; it depends on these two numbers alone."""

    def description(self) -> dict[str, Any]:
        """Return what makes the scenario what it is, ready for JSON."""


@dataclass(frozen=True)
class RandomMaps:
    """Gaussian mixtures with means uniform in a rectangle; the defaults are the paper's setup.

    Parameters
    ----------
    drone : Drone
        What the drone can do.
    start : str or (float, float)
        Where a run starts, see `StartRule`.
    area : (float, float, float, float)
        The search area x_min, y_min, x_max, y_max, m.
    components : int
        Number of Gaussians, of equal weight.
    covariance : (float, float, float, float)
        Their common covariance matrix row by row, m^2.
    """

    drone: Drone = field(default_factory=Drone)
    start: StartRule = "uniform"
    area: tuple[float, float, float, float] = _PAPER_AREA
    components: int = 4
    covariance: tuple[float, float, float, float] = _PAPER_COVARIANCE

    def __post_init__(self) -> None:
        finite_array(self.area, "area", (4,))
        finite_array(self.covariance, "covariance", (4,))
        if self.components < 1:
            raise InvalidInput(f"components must be at least 1, not {self.components}")
        _check_start(self.start)

    @classmethod
    def from_ros_parameters(cls, path: Path, start: StartRule = "uniform") -> RandomMaps:
        """Read the scenario from the ``/**`` section of a ROS 2 parameter file.

        Other parameters in the file, those of the nodes, are left alone.

        Raises
        ------
        InvalidInput
            If the file is not a ROS 2 parameter file, or a parameter is missing or wrong.
        """
        values = _common_parameters(path)
        needed = ("area", "components", "covariance", "step_length", "swath_radius", "waypoints")
        missing = [name for name in needed if name not in values]
        if missing:
            raise InvalidInput(f"{path}: {', '.join(missing)} missing under '/**: ros__parameters'")
        try:
            step = float(values["step_length"])
            drone = Drone(step, float(values["swath_radius"]), step * int(values["waypoints"]))
            x0, y0, x1, y1 = (float(v) for v in values["area"])
            xx, xy, yx, yy = (float(v) for v in values["covariance"])
            components = int(values["components"])
        except (TypeError, ValueError) as error:
            raise InvalidInput(
                f"{path}: {error}; area and covariance are lists of four numbers, the others "
                "single numbers"
            ) from None
        return cls(drone, start, (x0, y0, x1, y1), components, (xx, xy, yx, yy))

    def problem(self, seed: int, index: int) -> SearchProblem:
        """Return random problem `index` of `seed`."""
        x0, y0, x1, y1 = self.area
        rng = stream(seed, index, Facet.MAP)
        means = rng.uniform((x0, y0), (x1, y1), size=(self.components, 2))
        weights = np.full(self.components, 1.0 / self.components)
        covariance = np.reshape(np.asarray(self.covariance, dtype=np.float64), (2, 2))
        pdm = GaussianMixture(weights, means, np.tile(covariance, (self.components, 1, 1)))
        return _problem(pdm, SearchArea.rectangle(*self.area), self.drone, self.start, seed, index)

    def description(self) -> dict[str, Any]:
        """Return the parameters."""
        return {
            "maps": "random Gaussian mixtures",
            "area_m": list(self.area),
            "components": self.components,
            "covariance_m2": list(self.covariance),
            "start": _start_text(self.start),
            **self.drone.description(),
        }


@dataclass(frozen=True)
class FixedMap:
    """One given map; runs differ by their start and by where the persons are.

    Parameters
    ----------
    pdm : ProbabilityMap
        The map.
    search_area : SearchArea
        Where to search.
    name : str
        Where the map came from, for reports.
    drone : Drone
        What the drone can do.
    start : str or (float, float)
        Where a run starts, see `StartRule`.
    """

    pdm: ProbabilityMap
    search_area: SearchArea
    name: str
    drone: Drone
    start: StartRule = "uniform"

    def __post_init__(self) -> None:
        _check_start(self.start)

    def problem(self, seed: int, index: int) -> SearchProblem:
        """Return the problem on this map with start `index` of `seed`."""
        return _problem(self.pdm, self.search_area, self.drone, self.start, seed, index)

    def description(self) -> dict[str, Any]:
        """Return the parameters, the map as a digest of its probabilities."""
        x0, y0, x1, y1 = self.search_area.bounds
        cells = self.pdm.rasterize(Grid.covering((x0, y0, x1, y1), max(x1 - x0, y1 - y0) / 256))
        digest = hashlib.sha256(np.round(cells, 12).tobytes() + self.search_area.polygon.wkb)
        return {
            "maps": self.name,
            "map_digest": digest.hexdigest()[:16],
            "area_m": [x0, y0, x1, y1],
            "start": _start_text(self.start),
            **self.drone.description(),
        }


def persons_in_area(problem: SearchProblem, count: int, seed: int, index: int) -> FloatArray:
    """Return positions of missing persons, drawn from the map inside the area.

    Every planner of a run looks for the same persons.

    Parameters
    ----------
    problem : SearchProblem
        The problem of the run.
    count : int
        Number of persons P.
    seed, index : int
        The run.

    Returns
    -------
    (P, 2) float64
        Their positions, m.
    """
    rng = stream(seed, index, Facet.PERSONS)
    kept = np.empty((0, 2))
    while len(kept) < count:
        # As many as should do, given the share of the map that lies inside.
        wanted = int((count - len(kept)) / problem.probability_in_area * 1.1) + 16
        drawn = problem.pdm.sample(min(wanted, 100 * count), rng)
        kept = np.concatenate([kept, drawn[problem.area.contains(drawn)]])
    return kept[:count]


# Least probability in the area: persons are drawn from the map until enough lie inside.
_LEAST_INSIDE = 1e-6


def check_holds_persons(inside: float, name: str) -> None:
    """Check that missing persons can be drawn inside a search area.

    Parameters
    ----------
    inside : float
        Probability inside the area.
    name : str
        The map's file.

    Raises
    ------
    InvalidInput
        If the area holds next to nothing.
    """
    if inside < _LEAST_INSIDE:
        raise InvalidInput(
            f"{name}: its search area holds {inside:.1g} of the probability, too little to draw "
            "missing persons from; give an area where the map says that they are"
        )


def _problem(
    pdm: ProbabilityMap, area: SearchArea, drone: Drone, rule: StartRule, seed: int, index: int
) -> SearchProblem:
    """Put a problem together, its start by the rule."""
    return SearchProblem(
        pdm=pdm,
        area=area,
        start=_start(pdm, area, drone, rule, seed, index),
        step_length=drone.step_length,
        swath_radius=drone.swath_radius,
        max_distance=drone.max_distance,
    )


def _start(
    pdm: ProbabilityMap, area: SearchArea, drone: Drone, rule: StartRule, seed: int, index: int
) -> FloatArray:
    """Return the start of a run, (2,), m."""
    if not isinstance(rule, str):
        return np.asarray(rule, dtype=np.float64)
    if rule == "centre":
        return area.middle
    if rule == "peak":
        return most_probable_point(pdm, area, drone.swath_radius)
    x0, y0, x1, y1 = area.bounds
    rng = stream(seed, index, Facet.START)
    while True:
        points = rng.uniform((x0, y0), (x1, y1), size=(64, 2))
        inside = area.contains(points)
        if inside.any():
            return points[np.argmax(inside)]


def _check_start(rule: StartRule) -> None:
    if isinstance(rule, str):
        if rule not in START_RULES:
            raise InvalidInput(f"start must be {', '.join(START_RULES)} or X,Y, not {rule!r}")
    else:
        finite_array(rule, "start", (2,))


def _start_text(rule: StartRule) -> str:
    return rule if isinstance(rule, str) else f"{rule[0]:g},{rule[1]:g}"


def _common_parameters(path: Path) -> Mapping[str, Any]:
    """Return the parameters that a ROS 2 parameter file gives to all nodes."""
    content = read_yaml(path)
    section = content.get("/**") if isinstance(content, Mapping) else None
    values = section.get("ros__parameters") if isinstance(section, Mapping) else None
    if not isinstance(values, Mapping):
        raise InvalidInput(f"{path}: has no '/**: ros__parameters' section with parameters")
    return values
