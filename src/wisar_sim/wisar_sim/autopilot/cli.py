"""Command line of the simulated autopilot."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.codec import Codec, read_key_file
from wisar_planner.mavlink.transport import TcpTransport, Transport, UdpTransport, open_transport
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.bad_link import BadLink, LinkFaults
from wisar_sim.autopilot.profile import PROFILES
from wisar_sim.autopilot.server import Server
from wisar_sim.autopilot.storage import load_lists

_FAULTS = ("loss", "duplication", "reordering", "corruption", "delay_s", "jitter_s")

_MOST_ALTITUDE = 2_000_000.0
"""Metres of the home above the sea: GLOBAL_POSITION_INT holds 2,147 km, the flight included."""
_MOST_WIND = 300.0
"""Metres per second: GLOBAL_POSITION_INT holds velocities up to 327 m/s, the vehicle's included."""
_MOST_SPEED_UP = 1000.0
"""Simulated seconds per second: more is not computed in time to answer, or to end when told to."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="sim_autopilot",
        description="A MAVLink autopilot that takes missions and flies them, over a link as bad "
        "as wanted. Ends on SIGINT or SIGTERM.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument(
        "--connection",
        default="udpin:127.0.0.1:14550",
        help="udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcp:HOST:PORT or a serial "
        "device; port 0 takes a free one and prints it",
    )
    parser.add_argument("--profile", choices=sorted(PROFILES), default="px4")
    parser.add_argument(
        "--home",
        default="57.0,-4.0,0",
        help="LATITUDE,LONGITUDE[,ALTITUDE_M]; --home=-33.9,151.2 where it begins with -",
    )
    parser.add_argument("--system", type=int, default=1, help="own system id, 1 to 255")
    parser.add_argument(
        "--component",
        type=int,
        default=int(mav.MAV_COMP_ID_AUTOPILOT1),
        help="own component id, 1 to 255",
    )
    parser.add_argument("--wind", default="0,0", help="EAST,NORTH component in m/s")
    parser.add_argument(
        "--speed-up",
        type=float,
        default=1.0,
        help=f"simulated seconds per second, at most {_MOST_SPEED_UP:g}",
    )
    parser.add_argument("--key-file", type=Path, help="sign, and refuse what is not signed")
    parser.add_argument("--storage", type=Path, help="file in which missions survive a restart")
    parser.add_argument("--seed", type=int, default=0, help="of the faults of the link")
    for name in _FAULTS:
        for way, words in (("", "each way"), ("up-", "to the autopilot"), ("down-", "from it")):
            parser.add_argument(
                f"--{way}{name.replace('_', '-')}",
                type=float,
                default=argparse.SUPPRESS,
                help=f"{name.removesuffix('_s')} {words}"
                + (", s" if name.endswith("_s") else ", 0 to 1"),
            )
    return parser


def _numbers(name: str, text: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts:
        raise InvalidInput(f"--{name}: {text!r} must be {counts[-1]} numbers with commas between")
    return numbers


def _home(text: str) -> GeoOrigin:
    home = GeoOrigin(*_numbers("home", text, (2, 3)))
    _check_range("home", "altitude in metres", home.altitude, -_MOST_ALTITUDE, _MOST_ALTITUDE)
    return home


def _wind(text: str) -> tuple[float, float]:
    east, north = _numbers("wind", text, (2,))
    for name, speed in (("east", east), ("north", north)):
        _check_range("wind", f"{name} component in m/s", speed, -_MOST_WIND, _MOST_WIND)
    return east, north


def _check_numbers(args: argparse.Namespace) -> None:
    _check_range("system", "id", args.system, 1, 255)
    _check_range("component", "id", args.component, 1, 255)
    if args.seed < 0:
        raise InvalidInput(f"--seed: must be 0 or more, got {args.seed}")
    if not 0.0 < args.speed_up <= _MOST_SPEED_UP:
        raise InvalidInput(
            f"--speed-up: must be above 0 and at most {_MOST_SPEED_UP:g}, got {args.speed_up}"
        )


def _check_range(option: str, meaning: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:  # so written, NaN is refused too
        raise InvalidInput(
            f"--{option}: the {meaning} must be from {least:.0f} to {most:.0f}, got {value}"
        )


def _faults(args: argparse.Namespace, way: str) -> LinkFaults:
    chosen = {}
    for name in _FAULTS:
        value = getattr(args, f"{way}_{name}", getattr(args, name, None))
        if value is not None:
            chosen[name] = value
    return LinkFaults(**chosen)


def _where(transport: Transport, connection: str) -> str:
    kind, _, rest = connection.partition(":")
    if isinstance(transport, UdpTransport | TcpTransport) and kind in ("udp", "udpin", "tcpin"):
        return f"{kind}:{rest.removeprefix('//').rpartition(':')[0]}:{transport.port}"
    return connection


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulated autopilot until it is told to stop.

    Parameters
    ----------
    argv
        Command line without the program's name; None takes the process's own.

    Returns
    -------
    int
        Exit status: 0 after SIGINT or SIGTERM, 1 where the connection was lost or missions cannot
        be stored, 2 after a mistake in the arguments or a connection that cannot be opened.
    """
    args = _parser().parse_args(argv)
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    try:
        home, wind = _home(args.home), _wind(args.wind)
        _check_numbers(args)
        autopilot = Autopilot(
            PROFILES[args.profile],
            home,
            system=args.system,
            component=args.component,
            wind=wind,
            speed_up=args.speed_up,
        )
        key = None if args.key_file is None else read_key_file(args.key_file)
        if args.storage is not None:
            load_lists(args.storage, autopilot)
        up = BadLink(_faults(args, "up"), args.seed)
        down = BadLink(_faults(args, "down"), args.seed + 1)
        transport = open_transport(args.connection)
    except (InvalidInput, OSError) as error:
        print(f"sim_autopilot: {error}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    print(
        f"sim_autopilot: {args.profile}, system {args.system}, "
        f"ready on {_where(transport, args.connection)}",
        flush=True,
    )
    try:
        Server(
            autopilot,
            transport,
            Codec(args.system, args.component, key=key),
            up=up,
            down=down,
            storage=args.storage,
        ).run(lambda: stopped)
    except InvalidInput as error:
        print(f"sim_autopilot: {error}", file=sys.stderr)
        return 1  # 2 is for arguments, which end a whole launch
    except OSError as error:
        print(f"sim_autopilot: connection lost: {error}", file=sys.stderr)
        return 1
    finally:
        transport.close()
    return 0
