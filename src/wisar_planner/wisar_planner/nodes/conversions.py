"""Between ROS messages and domain objects; nothing else touches message fields.

Every function that reads a message checks it and raises `InvalidInput` with a text that says
what is wrong, so a node can refuse the message and keep its last good state.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from decimal import ROUND_CEILING, Context

import numpy as np
import shapely
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon
from std_msgs.msg import Header

from wisar_msgs import msg as wisar_msg
from wisar_planner.errors import InvalidInput, finite_array
from wisar_planner.pdm import GaussianMixture, Grid, ProbabilityMap
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_planner.search import SearchArea, SearchPath, SearchProblem, upper_bound

FloatArray = NDArray[np.float64]

SMALLEST_DEVIATION = 0.01
"""Metres: a component narrower than this is a mistake, and costs hours to integrate."""
LARGEST_COORDINATE = 1e7
"""Metres east or north, a quarter of the way around the Earth: no local frame goes further."""
LARGEST_SWATH = 1e5
"""Metres to either side of a path: no camera sees further."""
LARGEST_GRID = 4_000_000
"""Cells of an OccupancyGrid, 1 byte each: more floods the middleware and no display shows them."""


@dataclass(frozen=True)
class LocatedMap:
    """A probability map with its search area, its place on Earth and its identity.

    Parameters
    ----------
    map_id : str
        Name that plans refer to.
    pdm : GaussianMixture
        The map, in local metres.
    area : SearchArea
        Where to search, in local metres.
    origin : GeoOrigin
        Where the local frame lies.
    stamp_ns : int
        When the map was made, nanoseconds of the ROS clock.
    frame_id : str
        Name of the local frame.
    source : str
        The file or tool that the map came from.
    """

    map_id: str
    pdm: GaussianMixture
    area: SearchArea
    origin: GeoOrigin
    stamp_ns: int = 0
    frame_id: str = "map"
    source: str = ""


@dataclass(frozen=True)
class Plan:
    """A path with what it was planned for and how good it is.

    Parameters
    ----------
    path : SearchPath
        The path, in local metres.
    map_id : str
        Map that it was planned on.
    origin : GeoOrigin
        Where the local frame lies.
    probability : (N + 1,) ndarray
        Probability seen when each waypoint is reached.
    start : (2,) ndarray
        Where the drone was to start, m.
    step_length, budget : float
        Distance between waypoints and the distance that was allowed, m.
    probability_in_area, probability_efficiency, upper_bound : float
        p_A, e_p of the whole path, and the e_p that no path can exceed.
    planning_time : float
        Seconds.
    stamp_ns : int
        When the plan was made, nanoseconds of the ROS clock.
    frame_id : str
        Name of the local frame.
    """

    path: SearchPath
    map_id: str
    origin: GeoOrigin
    probability: FloatArray
    start: FloatArray
    step_length: float
    budget: float
    probability_in_area: float
    probability_efficiency: float
    upper_bound: float
    planning_time: float
    stamp_ns: int = 0
    frame_id: str = "map"

    @classmethod
    def of(
        cls, path: SearchPath, problem: SearchProblem, located: LocatedMap, planning_time: float
    ) -> Plan:
        """Evaluate a path on the problem that it was planned for."""
        probability = path.probability_at_waypoints(problem.pdm)
        return cls(
            path=path,
            map_id=located.map_id,
            origin=located.origin,
            probability=probability,
            start=np.asarray(problem.start, dtype=np.float64),
            step_length=problem.step_length,
            budget=problem.max_distance,
            probability_in_area=problem.probability_in_area,
            probability_efficiency=float(probability[-1]) / problem.probability_in_area,
            upper_bound=float(upper_bound(problem)),
            planning_time=planning_time,
            frame_id=located.frame_id,
        )


def stamp_from_ns(nanoseconds: int) -> Time:
    """Return a message stamp."""
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def stamp_to_ns(stamp: Time) -> int:
    """Return nanoseconds of a message stamp."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def header(stamp_ns: int, frame_id: str) -> Header:
    """Return a message header."""
    return Header(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)


def origin_to_msg(origin: GeoOrigin) -> wisar_msg.GeoOrigin:
    """Return the message of an origin."""
    return wisar_msg.GeoOrigin(
        latitude=float(origin.latitude),
        longitude=float(origin.longitude),
        altitude=float(origin.altitude),
    )


def origin_from_msg(message: wisar_msg.GeoOrigin) -> GeoOrigin:
    """Return the origin of a message.

    Raises
    ------
    InvalidInput
        When latitude, longitude or altitude cannot be right.
    """
    return GeoOrigin(message.latitude, message.longitude, message.altitude)


def area_to_msg(area: SearchArea) -> wisar_msg.SearchArea:
    """Return the message of a search area."""
    polygon = area.polygon
    parts = list(polygon.geoms) if isinstance(polygon, MultiPolygon) else [polygon]
    return wisar_msg.SearchArea(
        parts=[
            wisar_msg.AreaPolygon(
                exterior=_ring_to_msg(part.exterior),
                interiors=[_ring_to_msg(ring) for ring in part.interiors],
            )
            for part in parts
        ]
    )


def area_from_msg(message: wisar_msg.SearchArea) -> SearchArea:
    """Return the search area of a message.

    Raises
    ------
    InvalidInput
        When the area is empty, not finite or not a valid polygon.
    """
    if not message.parts:
        raise InvalidInput("area is empty: give at least one polygon to search in")
    polygons = []
    for index, part in enumerate(message.parts):
        name = f"area.parts[{index}]"
        exterior = _ring_from_msg(part.exterior, f"{name}.exterior")
        interiors = [
            _ring_from_msg(ring, f"{name}.interiors[{i}]") for i, ring in enumerate(part.interiors)
        ]
        polygons.append(Polygon(exterior, interiors))
    return SearchArea(polygons[0] if len(polygons) == 1 else MultiPolygon(polygons))


def map_to_msg(located: LocatedMap) -> wisar_msg.ProbabilityMap:
    """Return the message of a probability map."""
    return wisar_msg.ProbabilityMap(
        header=header(located.stamp_ns, located.frame_id),
        id=located.map_id,
        origin=origin_to_msg(located.origin),
        weights=located.pdm.weights.tolist(),
        means=located.pdm.means.ravel().tolist(),
        covariances=located.pdm.covariances.ravel().tolist(),
        area=area_to_msg(located.area),
        source=located.source,
    )


def map_from_msg(message: wisar_msg.ProbabilityMap) -> LocatedMap:
    """Return the probability map of a message.

    Raises
    ------
    InvalidInput
        When the id is missing, the arrays do not belong together, a number is not finite or no
        length on Earth, the weights do not sum to 1, a covariance is not positive definite or its
        standard deviation below `SMALLEST_DEVIATION`, the area is empty, or the map holds no
        probability inside its area.
    """
    if not message.id:
        raise InvalidInput("id is empty: a map needs a name that plans can refer to")
    count = len(message.weights)
    for name, size in (("means", 2), ("covariances", 4)):
        length = len(getattr(message, name))
        if length != size * count:
            raise InvalidInput(
                f"{name} has {length} values, but {count} weights need {size * count}"
            )
    pdm = GaussianMixture(
        np.array(message.weights, dtype=np.float64),
        np.array(message.means, dtype=np.float64).reshape(count, 2),
        np.array(message.covariances, dtype=np.float64).reshape(count, 2, 2),
    )
    _check_extent(pdm)
    area = area_from_msg(message.area)
    if not pdm.integrate(area.polygon) > 0.0:
        raise InvalidInput(
            "area holds no probability of the map: check that both use the same origin"
        )
    return LocatedMap(
        map_id=message.id,
        pdm=pdm,
        area=area,
        origin=origin_from_msg(message.origin),
        stamp_ns=stamp_to_ns(message.header.stamp),
        frame_id=message.header.frame_id,
        source=message.source,
    )


def plan_to_msg(plan: Plan) -> wisar_msg.SearchPlan:
    """Return the message of a plan."""
    return wisar_msg.SearchPlan(
        header=header(plan.stamp_ns, plan.frame_id),
        map_id=plan.map_id,
        planner=plan.path.planner,
        origin=origin_to_msg(plan.origin),
        x=plan.path.waypoints[:, 0].tolist(),
        y=plan.path.waypoints[:, 1].tolist(),
        probability=plan.probability.tolist(),
        start=[float(plan.start[0]), float(plan.start[1])],
        swath_radius=float(plan.path.swath_radius),
        step_length=float(plan.step_length),
        budget=float(plan.budget),
        length=float(plan.path.length),
        probability_in_area=float(plan.probability_in_area),
        probability_efficiency=float(plan.probability_efficiency),
        upper_bound=float(plan.upper_bound),
        planning_time=float(plan.planning_time),
    )


def plan_from_msg(message: wisar_msg.SearchPlan) -> Plan:
    """Return the plan of a message.

    Raises
    ------
    InvalidInput
        When there are no waypoints, the arrays do not belong together, a number is not finite or
        no length on Earth, or the probability is not between 0 and 1.
    """
    count = len(message.x)
    if count < 1 or len(message.y) != count or len(message.probability) != count:
        raise InvalidInput(
            f"x, y and probability must be equally long with at least one waypoint, "
            f"they have {count}, {len(message.y)} and {len(message.probability)} values"
        )
    probability = finite_array(message.probability, "probability", (None,))
    if probability.min() < 0.0 or probability.max() > 1.0 + 1e-9:
        raise InvalidInput("probability must lie between 0 and 1")
    waypoints = _coordinates(np.column_stack((message.x, message.y)), "waypoints")
    numbers = ("swath_radius", "step_length", "budget", "probability_in_area")
    for name in numbers:
        value = float(getattr(message, name))
        if not (math.isfinite(value) and value > 0.0):
            raise InvalidInput(f"{name} must be a finite number above 0, not {value}")
    if message.swath_radius > LARGEST_SWATH:
        raise InvalidInput(
            f"swath_radius must be at most {LARGEST_SWATH:g} m, not {message.swath_radius:g}"
        )
    return Plan(
        path=SearchPath(waypoints, message.swath_radius, planner=message.planner),
        map_id=message.map_id,
        origin=origin_from_msg(message.origin),
        probability=probability,
        start=finite_array(message.start, "start", (2,)),
        step_length=message.step_length,
        budget=message.budget,
        probability_in_area=message.probability_in_area,
        probability_efficiency=message.probability_efficiency,
        upper_bound=message.upper_bound,
        planning_time=message.planning_time,
        stamp_ns=stamp_to_ns(message.header.stamp),
        frame_id=message.header.frame_id,
    )


def plan_to_nav_path(plan: Plan) -> Path:
    """Return the plan as nav_msgs/Path, each pose looking along the leg that leaves it."""
    waypoints = plan.path.waypoints
    headings = np.zeros(len(waypoints))
    if len(waypoints) > 1:
        legs = np.diff(waypoints, axis=0)
        headings[:-1] = np.arctan2(legs[:, 1], legs[:, 0])
        headings[-1] = headings[-2]
    message_header = header(plan.stamp_ns, plan.frame_id)
    return Path(
        header=message_header,
        poses=[
            pose(point, heading, message_header)
            for point, heading in zip(waypoints, headings, strict=True)
        ],
    )


def pose(point: FloatArray, heading: float, message_header: Header) -> PoseStamped:
    """Return a pose on the ground plane; `heading` in radians from east, counter-clockwise."""
    message = PoseStamped(header=message_header)
    message.pose.position.x = float(point[0])
    message.pose.position.y = float(point[1])
    message.pose.orientation.z = math.sin(heading / 2.0)
    message.pose.orientation.w = math.cos(heading / 2.0)
    return message


def grid_to_msg(
    pdm: ProbabilityMap, area: SearchArea, cell: float, message_header: Header
) -> OccupancyGrid:
    """Return the map as an OccupancyGrid: 100 at the area's most probable cell, -1 outside it.

    Parameters
    ----------
    pdm, area
        The map and where to search, in local metres.
    cell : float
        Side of a cell, m.
    message_header : Header
        Stamp and frame.

    Raises
    ------
    InvalidInput
        When the grid would have more than `LARGEST_GRID` cells.
    """
    xmin, ymin, xmax, ymax = area.bounds
    # In floats and before any array is made: the count may exceed every integer type.
    count = max(1.0, (xmax - xmin) / cell) * max(1.0, (ymax - ymin) / cell)
    if count > LARGEST_GRID:
        # A strip may be narrower than a cell.
        smallest = max(
            math.sqrt((xmax - xmin) * (ymax - ymin) / LARGEST_GRID),
            max(xmax - xmin, ymax - ymin) / LARGEST_GRID,
        )
        # Rounded up, and from a hair above against the rounding here: what is told must be taken.
        up = Context(prec=3, rounding=ROUND_CEILING)
        told = up.create_decimal_from_float(smallest * (1.0 + 1e-12))
        raise InvalidInput(
            f"a grid of {cell:g} m cells over this area would have {count:.3g} cells, more than "
            f"{LARGEST_GRID}: choose cells of at least {float(told):.3g} m"
        )
    grid = Grid.covering(area.bounds, cell)
    probability = pdm.rasterize(grid)
    centres = grid.centres()
    inside = shapely.contains_xy(area.polygon, centres[..., 0], centres[..., 1])
    # What is to be searched shows its own peak: the map's may lie in a hole.
    peak = float(probability.max(where=inside, initial=0.0))
    share = np.clip(probability, 0.0, peak) / (peak if peak > 0.0 else 1.0)
    scaled = np.rint(100.0 * share).astype(np.int8)
    message = OccupancyGrid(header=message_header)
    message.info.map_load_time = message_header.stamp
    message.info.resolution = float(grid.cell)
    message.info.width = int(grid.columns)
    message.info.height = int(grid.rows)
    message.info.origin.position.x = float(grid.x0)
    message.info.origin.position.y = float(grid.y0)
    message.info.origin.orientation.w = 1.0
    message.data = array("b", np.where(inside, scaled, np.int8(-1)).tobytes())
    return message


def _ring_to_msg(ring: shapely.LinearRing) -> wisar_msg.Ring:
    coordinates = shapely.get_coordinates(ring)[:-1]
    return wisar_msg.Ring(x=coordinates[:, 0].tolist(), y=coordinates[:, 1].tolist())


def _ring_from_msg(message: wisar_msg.Ring, name: str) -> FloatArray:
    if len(message.x) != len(message.y) or len(message.x) < 3:
        raise InvalidInput(
            f"{name} needs at least 3 points, as many x as y; "
            f"it has {len(message.x)} x and {len(message.y)} y"
        )
    return _coordinates(np.column_stack((message.x, message.y)), name)


def _coordinates(points: FloatArray, name: str) -> FloatArray:
    """Return points, (N, 2) m, that can lie in a local frame, or raise InvalidInput."""
    points = finite_array(points, name, (None, 2))
    largest = float(np.abs(points).max(initial=0.0))
    if largest > LARGEST_COORDINATE:
        raise InvalidInput(
            f"{name} must be metres from the origin, at most {LARGEST_COORDINATE:g}: "
            f"one is {largest:g}"
        )
    return points


def _check_extent(pdm: GaussianMixture) -> None:
    """Raise InvalidInput where a component is narrower or wider than anything on the ground."""
    _coordinates(pdm.means, "means")
    deviations = np.sqrt(np.linalg.eigvalsh(pdm.covariances))
    narrow = deviations[:, 0] < SMALLEST_DEVIATION
    wide = deviations[:, 1] > LARGEST_COORDINATE
    if narrow.any():
        k = int(narrow.argmax())
        raise InvalidInput(
            f"covariances of component {k} have a standard deviation of {deviations[k, 0]:.3g} m, "
            f"below {SMALLEST_DEVIATION:g} m; they are square metres"
        )
    if wide.any():
        k = int(wide.argmax())
        raise InvalidInput(
            f"covariances of component {k} have a standard deviation of {deviations[k, 1]:.3g} m, "
            f"above {LARGEST_COORDINATE:g} m; they are square metres"
        )
