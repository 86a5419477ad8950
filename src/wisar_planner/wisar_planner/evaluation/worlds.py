"""Worlds: named families of search problems from a YAML file, to compare planners in all of them.

The file is a mapping ``worlds: {NAME: {KEY: VALUE}}``; names have no comma, which separates them
where several are chosen. What a world does not say is the paper's setup. Its keys are the fields
of `_Description`; lengths are in metres.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from wisar_planner.errors import InvalidInput, positive
from wisar_planner.evaluation.scenario import (
    Drone,
    FixedMap,
    RandomMaps,
    Scenario,
    check_holds_persons,
)
from wisar_planner.evaluation.streams import Facet, stream
from wisar_planner.pdm import GaussianMixture, Grid, ProbabilityMap, RasterMap
from wisar_planner.search import SearchArea, SearchProblem
from wisar_planner.yaml_files import read_yaml


@dataclass(frozen=True)
class VariedMixtures:
    """Gaussian mixtures whose components differ in weight, size, shape and direction.

    Parameters
    ----------
    base : RandomMaps
        Area, start, drone and number of components; its covariance is not used.
    deviations : (float, float)
        Smallest and largest standard deviation along an axis of a component, m; its logarithm is
        uniform. The axes point anywhere, and the weights are uniform on the simplex.
    """

    base: RandomMaps
    deviations: tuple[float, float]

    @property
    def drone(self) -> Drone:
        """What the drone can do."""
        return self.base.drone

    def problem(self, seed: int, index: int) -> SearchProblem:
        """Return random problem `index` of `seed`."""
        rng = stream(seed, index, Facet.MAP)
        count = self.base.components
        x0, y0, x1, y1 = self.base.area
        means = rng.uniform((x0, y0), (x1, y1), size=(count, 2))
        low, high = np.log(self.deviations)
        deviations = np.exp(rng.uniform(low, high, size=(count, 2)))
        turn = rng.uniform(0.0, math.pi, size=count)
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        roots = axes.transpose(2, 0, 1) * deviations[:, None, :]
        covariances = roots @ roots.transpose(0, 2, 1)
        # Symmetric to the last bit.
        covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
        pdm = GaussianMixture(rng.dirichlet(np.ones(count)), means, covariances)
        return _with_map(self.base, pdm, seed, index)

    def description(self) -> dict[str, Any]:
        """Return the parameters."""
        return {
            **self.base.description(),
            "maps": "random Gaussian mixtures of all shapes",
            "covariance_m2": None,
            "deviations_m": list(self.deviations),
        }


@dataclass(frozen=True)
class SmoothRasters:
    """Rasters of the exponential of smooth noise: log-Gaussian fields, with no modes to know of.

    Parameters
    ----------
    base : RandomMaps
        Area, start and drone; its mixture is not used.
    cell : float
        Side of a cell, m.
    smoothness : float
        Standard deviation of the Gaussian that smooths the noise, m.
    contrast : float
        Standard deviation of the logarithm of the density.
    """

    base: RandomMaps
    cell: float
    smoothness: float
    contrast: float

    @property
    def drone(self) -> Drone:
        """What the drone can do."""
        return self.base.drone

    def problem(self, seed: int, index: int) -> SearchProblem:
        """Return random problem `index` of `seed`."""
        rng = stream(seed, index, Facet.MAP)
        grid = Grid.covering(self.base.area, self.cell)
        noise = rng.standard_normal((grid.rows, grid.columns))
        field = gaussian_filter(noise, self.smoothness / self.cell, mode="wrap")
        mass = np.exp(self.contrast * (field - field.mean()) / max(field.std(), 1e-12))
        return _with_map(self.base, RasterMap(mass / mass.sum(), grid), seed, index)

    def description(self) -> dict[str, Any]:
        """Return the parameters."""
        return {
            **self.base.description(),
            "maps": "smooth random rasters",
            "components": None,
            "covariance_m2": None,
            "cell_m": self.cell,
            "smoothness_m": self.smoothness,
            "contrast": self.contrast,
        }


@dataclass(frozen=True)
class Rasterised:
    """The maps of another scenario as rasters over the area and a swath around it.

    Parameters
    ----------
    base : RandomMaps or VariedMixtures
        The scenario.
    cell : float
        Side of a cell, m.
    """

    base: RandomMaps | VariedMixtures
    cell: float

    @property
    def drone(self) -> Drone:
        """What the drone can do."""
        return self.base.drone

    def problem(self, seed: int, index: int) -> SearchProblem:
        """Return problem `index` of `seed`."""
        problem = self.base.problem(seed, index)
        x0, y0, x1, y1 = problem.area.bounds
        edge = problem.swath_radius
        grid = Grid.covering((x0 - edge, y0 - edge, x1 + edge, y1 + edge), self.cell)
        return replace(problem, pdm=RasterMap(problem.pdm.rasterize(grid), grid))

    def description(self) -> dict[str, Any]:
        """Return the parameters."""
        base = self.base.description()
        return {**base, "maps": f"{base['maps']}, as rasters", "cell_m": self.cell}


@dataclass(frozen=True)
class World:
    """A scenario and its name; without a scenario, why there is none.

    Parameters
    ----------
    name : str
        Its name, of its own.
    entry : str
        The name in the file, which worlds of several GIS files share.
    scenario : Scenario or None
        The scenario.
    missing : str
        Why there is no scenario.
    """

    name: str
    entry: str
    scenario: Scenario | None
    missing: str = ""


@dataclass(frozen=True)
class _Description:
    """The keys of a world in the file.

    Parameters
    ----------
    side : float
        Side of the square area.
    components, variance : int, float
        Gaussians of a map, and the variance that all share along both axes, m^2.
    deviations : list of float
        Smallest and largest standard deviation; Gaussians of all shapes instead of `variance`.
    step, swath_radius : float
        Step length and swath radius.
    steps : int
        Steps of the budget.
    scale : float
        All the lengths above, and `cell` and `smoothness`, are multiplied by this.
    start : str
        Where a run starts: uniform, peak or centre.
    cell : float
        Side of the cells; the mixtures become rasters.
    smoothness, contrast : float
        Smooth random rasters instead of mixtures, with cells of `cell`; see `SmoothRasters`.
    maps : str
        Pattern of GIS files, relative to the YAML file, instead of random maps: one world a file.
    budget : float
        Longest path, instead of `steps`.
    disc : float
        Radius of the disc about the centre of a GIS map to search; all of the map unless given.
    """

    side: float = 150.0
    components: int = 4
    variance: float = 500.0
    deviations: tuple[float, float] | None = None
    step: float = 8.0
    swath_radius: float = 2.5
    steps: int = 64
    scale: float = 1.0
    start: str = "uniform"
    cell: float | None = None
    smoothness: float | None = None
    contrast: float = 1.5
    maps: str | None = None
    budget: float | None = None
    disc: float | None = None

    @classmethod
    def of(cls, values: Any, where: str) -> _Description:
        """Check the keys of a world and the kinds of their values."""
        if not isinstance(values, Mapping):
            raise InvalidInput(f"{where} must be a mapping; write {{}} for the paper's setup")
        known = {field.name: field for field in dataclasses.fields(cls)}
        checked: dict[str, Any] = {}
        for key, value in values.items():
            if key not in known:
                raise InvalidInput(f"{where} has no key {key!r}; the keys are {', '.join(known)}")
            if key in ("start", "maps"):
                checked[key] = str(value)
            elif key == "deviations":
                checked[key] = _range(value, f"{where}: {key}")
            elif key in ("components", "steps"):
                if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                    raise InvalidInput(f"{where}: {key} must be a whole number from 1, not {value}")
                checked[key] = value
            else:
                checked[key] = positive(value, f"{where}: {key}")
        described = cls(**checked)
        described.drone.check_step_fits(f"{where}: step", "its budget")
        return described

    @property
    def drone(self) -> Drone:
        """What the drone can do."""
        step = self.scale * self.step
        distance = self.steps * step if self.budget is None else self.scale * self.budget
        return Drone(step, self.scale * self.swath_radius, distance)

    def scenario(self, where: str) -> Scenario:
        """Return the random maps."""
        side, variance = self.scale * self.side, self.scale**2 * self.variance
        covariance = (variance, 0.0, 0.0, variance)
        base = RandomMaps(
            self.drone, self.start, (0.0, 0.0, side, side), self.components, covariance
        )
        cell = None if self.cell is None else self.scale * self.cell
        if self.smoothness is not None:
            if cell is None:
                raise InvalidInput(f"{where}: smoothness needs a cell")
            return SmoothRasters(base, cell, self.scale * self.smoothness, self.contrast)
        mixtures: RandomMaps | VariedMixtures = base
        if self.deviations is not None:
            low, high = self.deviations
            mixtures = VariedMixtures(base, (self.scale * low, self.scale * high))
        return mixtures if cell is None else Rasterised(mixtures, cell)


def read_worlds(path: Path, maps: Path | None = None) -> list[World]:
    """Return the worlds of a file.

    Parameters
    ----------
    path : Path
        The YAML file.
    maps : Path, optional
        Folder of the GIS files, instead of the one that the file names.

    Raises
    ------
    InvalidInput
        If the file is not such a file; the message names the world and the key.
    """
    content = read_yaml(path)
    described = content.get("worlds") if isinstance(content, Mapping) else None
    if not isinstance(described, Mapping) or not described:
        raise InvalidInput(f"{path}: has no 'worlds' mapping with a world")
    worlds: list[World] = []
    for name, values in described.items():
        where = f"{path}: world {name!r}"
        if "," in str(name):
            raise InvalidInput(f"{where}: a comma separates names; choose a name without one")
        try:
            world = _Description.of(values, where)
            if world.maps is None:
                worlds.append(World(str(name), str(name), world.scenario(where)))
            else:
                worlds.extend(_gis_worlds(str(name), world, path.parent, maps))
        except InvalidInput as error:
            # Maps, areas and scenarios do not know for which world they are made.
            text = str(error)
            raise InvalidInput(text if text.startswith(where) else f"{where}: {text}") from None
    for name, count in Counter(world.name for world in worlds).items():
        # A file may give a world the name of another entry; their results would be mixed up.
        if count > 1:
            raise InvalidInput(f"{path}: two worlds are called {name!r}; rename one")
    return worlds


def _gis_worlds(
    entry: str, world: _Description, home: Path, folder: Path | None
) -> Iterator[World]:
    """Yield a world for each GIS file, or one that says that there is none."""
    from wisar_planner.pdm.gis import load_map

    pattern = Path(world.maps or "")
    where = folder if folder is not None else home / pattern.parent
    files = sorted(where.glob(pattern.name)) if where.is_dir() else []
    if not files:
        yield World(entry, entry, None, f"skipped: no file {pattern.name} in {where}")
    for file in files:
        loaded = load_map(file)
        polygon = loaded.area
        if world.disc is not None:
            centre = polygon.envelope.centroid
            polygon = polygon.intersection(centre.buffer(world.disc, quad_segs=32))
            if not polygon.area > 0.0:
                raise InvalidInput(
                    f"disc: none of the area of {file} is within {world.disc:g} m of the middle of "
                    "its bounds; give a larger disc"
                )
        check_holds_persons(loaded.pdm.integrate(polygon), str(file))
        area = SearchArea.from_polygon(polygon)
        scenario = FixedMap(loaded.pdm, area, file.name, world.drone, world.start)
        yield World(f"{entry} {file.stem}", entry, scenario)


def _with_map(base: RandomMaps, pdm: ProbabilityMap, seed: int, index: int) -> SearchProblem:
    """Return problem `index` of `seed` with another map; area, start and drone are the same."""
    problem = FixedMap(pdm, SearchArea.rectangle(*base.area), "", base.drone, base.start)
    return problem.problem(seed, index)


def _range(value: Any, where: str) -> tuple[float, float]:
    """Read two positive numbers in order."""
    if not isinstance(value, list) or len(value) != 2:
        raise InvalidInput(f"{where} must be a list of two lengths, not {value!r}")
    low, high = positive(value[0], where), positive(value[1], where)
    if low > high:
        raise InvalidInput(f"{where} must be the smaller length first, not {value!r}")
    return low, high
