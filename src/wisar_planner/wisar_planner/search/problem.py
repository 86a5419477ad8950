"""The search problem: what a planner is given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from wisar_planner.errors import FloatArray, InvalidInput, finite_array, positive
from wisar_planner.pdm import GaussianMixture, ProbabilityMap
from wisar_planner.search.area import SearchArea

#: Steps of the longest search that a user may ask for, far more than any drone flies in one: what
#: asks for more has a wrong unit, and would occupy a planner until all memory is used up.
MOST_STEPS = 200_000


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """A map, an area, a start, and what the drone can do.

    Parameters
    ----------
    pdm : ProbabilityMap
        Where the missing person may be.
    area : SearchArea
        Where to search; waypoints and the legs between them stay inside it. Only patterns fly
        across the ground between separate parts.
    start : (2,) array_like
        Where the search begins, m; inside `area` or on its border.
    step_length : float
        Distance between waypoints, m (the paper's lambda).
    swath_radius : float
        Distance to either side of the path that is seen, m (the paper's R_buffer).
    max_distance : float
        Longest path, m.

    Raises
    ------
    InvalidInput
        When an argument is not finite or not positive, `start` lies outside `area`, or the map
        holds no probability inside `area`.
    """

    pdm: ProbabilityMap
    area: SearchArea
    start: FloatArray
    step_length: float
    swath_radius: float
    max_distance: float

    def __post_init__(self) -> None:
        if not isinstance(self.pdm, ProbabilityMap):
            raise InvalidInput(f"pdm must be a probability map, not {type(self.pdm).__name__}")
        if not isinstance(self.area, SearchArea):
            raise InvalidInput(f"area must be a SearchArea, not {type(self.area).__name__}")
        start = finite_array(self.start, "start", (2,))
        start.flags.writeable = False
        object.__setattr__(self, "start", start)
        for name in ("step_length", "swath_radius", "max_distance"):
            object.__setattr__(self, name, positive(getattr(self, name), name))
        if not self.area.contains(start[None, :])[0]:
            raise InvalidInput(
                f"start ({start[0]:g}, {start[1]:g}) lies outside the search area with bounds "
                f"{tuple(round(b, 3) for b in self.area.bounds)}; move it inside"
            )
        if not self.probability_in_area > 0.0:
            raise InvalidInput(
                "area holds no probability of the map; check that map and area use the same origin"
            )

    @property
    def steps(self) -> int:
        """Number of whole steps that `max_distance` allows."""
        return math.floor(self.max_distance / self.step_length + 1e-9)

    def check_steps(self, *, step: str, budget: str) -> None:
        """Refuse a search that no planner ends in a reasonable time.

        Parameters
        ----------
        step, budget : str
            What the user knows `step_length` and `max_distance` by.

        Raises
        ------
        InvalidInput
            When the budget allows more than `MOST_STEPS`.
        """
        # In floats: the count may exceed every integer type.
        count = self.max_distance / self.step_length
        if count > MOST_STEPS:
            raise InvalidInput(
                f"{budget}: {self.max_distance:g} m in steps of {self.step_length:g} m are "
                f"{count:.7g} steps, more than {MOST_STEPS:,}; give a longer {step} or a smaller "
                f"{budget}"
            )

    @cached_property
    def probability_in_area(self) -> float:
        """Probability that the person is in the area (the paper's p_A)."""
        return self.pdm.integrate(self.area.polygon)

    @classmethod
    def paper(
        cls, rng: np.random.Generator, *, start: npt.ArrayLike | None = None
    ) -> SearchProblem:
        """Return a random problem of the paper's setup.

        An area of 150 m x 150 m with 4 Gaussians of covariance 500 I m^2, their means uniform in
        the area, steps of 8 m, a swath radius of 2.5 m and 64 steps (512 m).

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of randomness.
        start : (2,) array_like, optional
            Start of the search, m; uniform in the area unless given.
        """
        area = SearchArea.rectangle(0.0, 0.0, 150.0, 150.0)
        pdm = GaussianMixture.random(rng, area.bounds)
        if start is None:
            start = rng.uniform(0.0, 150.0, size=2)
        return cls(
            pdm=pdm,
            area=area,
            start=np.asarray(start, dtype=np.float64),
            step_length=8.0,
            swath_radius=2.5,
            max_distance=512.0,
        )
