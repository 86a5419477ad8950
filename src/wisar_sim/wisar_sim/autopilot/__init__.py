"""A simulated autopilot that answers as PX4, ArduPilot or MAVSDK do."""

from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.bad_link import BadLink, LinkFaults
from wisar_sim.autopilot.cli import main
from wisar_sim.autopilot.profile import PROFILES, Profile

__all__ = ["PROFILES", "Autopilot", "BadLink", "LinkFaults", "Profile", "main"]
