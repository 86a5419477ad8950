"""A point mass that flies through the air: speed limits, acceleration, wind."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Airframe:
    """What the vehicle can do.

    Parameters
    ----------
    cruise_speed
        Ground speed in m/s when the mission asks for none.
    max_airspeed
        Greatest horizontal speed through the air, m/s.
    climb_speed
        Vertical speed, m/s.
    acceleration
        Greatest change of the horizontal velocity, m/s^2.
    acceptance_radius
        Distance in metres at which a waypoint counts as reached.
    """

    cruise_speed: float = 8.0
    max_airspeed: float = 18.0
    climb_speed: float = 3.0
    acceleration: float = 4.0
    acceptance_radius: float = 2.0


@dataclass
class Body:
    """Position and velocity of the vehicle, east-north-up, relative to home.

    Parameters
    ----------
    airframe
        What it can do.
    wind
        East and north component of the wind in m/s (where the air goes to).
    """

    airframe: Airframe = field(default_factory=Airframe)
    wind: tuple[float, float] = (0.0, 0.0)
    position: Vector = field(default_factory=lambda: np.zeros(3))
    velocity: Vector = field(default_factory=lambda: np.zeros(3))

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle stands."""
        return bool(self.position[2] <= 0.0)

    def fly_towards(self, target: Vector, speed: float, dt: float) -> None:
        """Move for `dt` seconds towards a point, at `speed` m/s over ground if the wind allows.

        The ground velocity that is wanted needs a velocity through the air, which is limited;
        in a wind stronger than the airspeed the vehicle is blown away, as a real one is.
        """
        frame = self.airframe
        to_go = target[:2] - self.position[:2]
        distance = float(math.hypot(to_go[0], to_go[1]))
        # Slow down so that stopping at the target stays within the acceleration.
        wanted_speed = min(speed, math.sqrt(2.0 * frame.acceleration * distance))
        if distance < 1e-9:
            wanted = np.zeros(2)
        else:
            wanted = to_go / distance * min(wanted_speed, distance / dt)
        wind = np.asarray(self.wind)
        through_air = wanted - wind
        airspeed = float(math.hypot(through_air[0], through_air[1]))
        if airspeed > frame.max_airspeed:
            through_air *= frame.max_airspeed / airspeed
        change = through_air + wind - self.velocity[:2]
        most = frame.acceleration * dt
        size = float(math.hypot(change[0], change[1]))
        if size > most:
            change *= most / size
        self.velocity[:2] += change
        climb = (target[2] - self.position[2]) / dt
        self.velocity[2] = min(max(climb, -frame.climb_speed), frame.climb_speed)
        self.position += self.velocity * dt

    def stand(self) -> None:
        """Stand on the ground."""
        self.position[2] = 0.0
        self.velocity[:] = 0.0

    def within(self, target: Vector, radius: float) -> bool:
        """Whether a point is nearer than `radius` metres."""
        return bool(np.linalg.norm(self.position - target) <= radius)
