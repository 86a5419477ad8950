"""Benchmark of the MAVLink library: bad links, cut links, hostile bytes, and speed beside MAVSDK.

Everything stays inside this process or on 127.0.0.1 and is bounded in count and time. The
simulated autopilot is a package of its own, `wisar_sim`, which these rows need.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import os
import select
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from wisar_planner.evaluation.bench_row import BenchRow
from wisar_planner.mavlink.client import LinkError, MissionClient
from wisar_planner.mavlink.codec import Codec, Message
from wisar_planner.mavlink.dialect import dialect_of
from wisar_planner.mavlink.exchange import Address, item_message
from wisar_planner.mavlink.link import Link
from wisar_planner.mavlink.link_estimate import LinkEstimates
from wisar_planner.mavlink.mission import Mission, MissionItem, MissionKind, build_mission
from wisar_planner.mavlink.outcome import UploadResult
from wisar_planner.mavlink.session import Session
from wisar_planner.mavlink.transfer import MissionTransfer
from wisar_planner.mavlink.upload import Upload, UploadEnd

if TYPE_CHECKING:
    from wisar_sim.autopilot.bad_link import LinkFaults
    from wisar_sim.autopilot.mission_server import MissionServer, StoredItem

UPLOADS = 1_000
CUTS = 200
FRAMES = 1_000_000
_ONLY_MISSION = [MissionKind.MISSION]
_VEHICLE = Address(1, 1)
_REAL_UPLOADS = {0.0: 16, 0.1: 16, 0.3: 8, 0.5: 4}
_CLEAN_REPETITIONS = 30
_LATEST_CUT_S = 14.0  # about when the read-back of the longest uploads ends


def _mission(items: int, north: float = 57.0, altitude: float = 40.0) -> Mission:
    """Make a mission of exactly so many items."""
    plan = np.column_stack((north + 1e-4 * np.arange(items - 3), np.full(items - 3, -4.0)))
    mission = build_mission(plan, altitude_m=altitude, speed=8.0)
    assert len(mission.items) == items
    return mission


def _stored(mission: Mission) -> tuple[StoredItem, ...]:
    from wisar_sim.autopilot.mission_server import StoredItem

    return tuple(StoredItem(i.command, i.frame, i.params, i.x, i.y, i.z) for i in mission.items)


def _places(items: Any) -> list[tuple[int, int, int, float]]:
    return [(i.command, i.x, i.y, i.z) for i in items]


def _server(profile: str) -> MissionServer:
    from wisar_sim.autopilot.mission_server import MissionServer, StoredItem
    from wisar_sim.autopilot.profile import PROFILES

    home = StoredItem(16, 0, (0.0, 0.0, 0.0, 0.0), 570_000_000, -40_000_000, 0.0)
    return MissionServer(PROFILES[profile], lambda: home)


def _transfer(mission: Mission, server: MissionServer) -> MissionTransfer:
    dialect = dialect_of(server.profile.autopilot)
    return MissionTransfer(mission, _VEHICLE, dialect, kinds=_ONLY_MISSION)


# -- uploads over bad links ------------------------------------------------------------------


def _faults(loss: float, duplication: float = 0.1) -> LinkFaults:
    from wisar_sim.autopilot.bad_link import LinkFaults

    return LinkFaults(
        loss=loss,
        duplication=duplication,
        reordering=0.1,
        corruption=0.01,
        delay_s=0.02,
        jitter_s=0.02,
    )


class _Held(Enum):
    """Which mission the autopilot holds in the end."""

    OLD = 1
    NEW = 2
    OTHER = 3


@dataclass(frozen=True)
class _Outcomes:
    """What came of many uploads.

    Parameters
    ----------
    uploads, verified
        How many there were, and how many the client says are verified.
    failed_in_words
        Not verified, with a sentence that says why.
    left_open
        Of those, the ones that end without the client knowing what the autopilot holds.
    changed
        Of those, the ones after which the autopilot does not hold its old mission.
    corrupted
        Uploads after which the autopilot holds neither the old nor the new mission, or not the new
        one although the client says so.
    median_s, longest_s
        Duration of an upload, read-back included.
    """

    uploads: int
    verified: int
    failed_in_words: int
    left_open: int
    changed: int
    corrupted: int
    median_s: float
    longest_s: float

    @classmethod
    def of(cls, results: list[tuple[UploadResult, _Held]]) -> _Outcomes:
        """Count results, each with what the autopilot holds after it."""
        times = [result.elapsed_s for result, _ in results]
        failed = [(result, held) for result, held in results if not result.verified]
        return cls(
            uploads=len(results),
            verified=len(results) - len(failed),
            failed_in_words=sum(bool(result.error) for result, _ in failed),
            left_open=sum(not result.old_counts for result, _ in failed),
            changed=sum(held is not _Held.OLD for _, held in failed),
            corrupted=sum(
                held is _Held.OTHER or (result.verified and held is not _Held.NEW)
                for result, held in results
            ),
            median_s=statistics.median(times),
            longest_s=max(times),
        )

    @property
    def words(self) -> str:
        """The counts in one line."""
        return (
            f"{self.verified:,} of {self.uploads:,} verified, {self.failed_in_words} failed in "
            f"words, {self.left_open} left open, {self.changed} changed, {self.corrupted} "
            f"corrupted, median {self.median_s:.3g} s"
        )


def _held(items: Any, old: Mission, new: Mission) -> _Held:
    places = _places(items)
    if places == _places(new.items):
        return _Held.NEW
    return _Held.OLD if places == _places(old.items) else _Held.OTHER


def _simulated_uploads(
    profile: str, loss: float, count: int, duplication: float = 0.1
) -> _Outcomes:
    """Upload at simulated time: real frames and state machines, a simulated wire and clock."""
    from wisar_sim.autopilot.bad_link import BadLink
    from wisar_sim.autopilot.conversation import Conversation

    old, new = _mission(10, north=56.0), _mission(64)
    faults = _faults(loss, duplication)
    results = []
    for seed in range(count):
        server = _server(profile)
        server.lists[0] = _stored(old)
        talk = Conversation(server, BadLink(faults, 2 * seed), BadLink(faults, 2 * seed + 1))
        talk.now = 60.0  # long after boot
        transfer = _transfer(new, server)
        talk.run(transfer)
        talk.settle(60.0)
        assert transfer.result is not None
        results.append((transfer.result, _held(server.lists[0], old, new)))
    return _Outcomes.of(results)


def _real_uploads(loss: float, count: int) -> _Outcomes:
    """Upload over UDP sockets on 127.0.0.1, in real time."""
    old, new = _mission(10, north=56.0), _mission(64)

    def one(seed: int) -> tuple[UploadResult, _Held]:
        options = ["--loss", str(loss), "--duplication", "0.1", "--reordering", "0.1"]
        options += ["--corruption", "0.01", "--seed", str(1000 * seed)]
        with (
            _sim_autopilot("px4", *options) as port,
            MissionClient(f"udpout:127.0.0.1:{port}") as client,
        ):
            client.wait_heartbeat(60.0)
            before = client.upload(old, kinds=_ONLY_MISSION)
            if not before.verified:
                return before, _Held.OTHER
            result = client.upload(new, kinds=_ONLY_MISSION)
            for _ in range(20):
                with contextlib.suppress(LinkError):
                    return result, _held(client.download(), old, new)
        return result, _Held.OTHER

    with ThreadPoolExecutor(8) as pool:
        return _Outcomes.of(list(pool.map(one, range(count))))


def _mavsdk_uploads(loss: float, count: int) -> int:
    """Return how many uploads MAVSDK's own client completes on the same links."""
    if not _has_mavsdk():
        return 0

    def one(seed: int) -> bool:
        options = ["--loss", str(loss), "--duplication", "0.1", "--reordering", "0.1"]
        options += ["--corruption", "0.01", "--seed", str(1000 * seed)]
        with _sim_autopilot("px4", *options) as port, _mavsdk_client(port) as upload:
            return upload is not None and upload(_mission(64))

    with ThreadPoolExecutor(4) as pool:
        return sum(pool.map(one, range(count)))


def _loss_row(percent: int) -> BenchRow:
    loss = percent / 100.0
    main = _simulated_uploads("px4", loss, UPLOADS)
    others = {p: _simulated_uploads(p, loss, UPLOADS // 5) for p in ("mavsdk", "ardupilot")}
    real = _real_uploads(loss, _REAL_UPLOADS[loss])
    compared = _REAL_UPLOADS[loss]
    theirs = _mavsdk_uploads(loss, compared) / compared if _has_mavsdk() else None
    ours = real.verified / real.uploads
    return BenchRow(
        name=f"mission_upload_loss_{percent}",
        unit=f"share of {real.uploads} complete over UDP; simulated: {main.words}",
        ours=ours,
        peer=theirs,
        peer_name=f"MAVSDK {version('mavsdk')}, not verified" if theirs is not None else None,
        ratio=ours / theirs if theirs else None,
        details={
            **vars(main),
            "how": "64 items, px4 profile, simulated time; faults each way",
            "faults": vars(_faults(loss)),
            "other_profiles": {name: vars(outcomes) for name, outcomes in others.items()},
            "real_udp": vars(real),
            "peer_uploads": compared if theirs is not None else 0,
        },
    )


# -- cut links -------------------------------------------------------------------------------


def _cut_row() -> BenchRow:
    """Cut the link for good at random moments of an upload, and see what either side holds."""
    from wisar_sim.autopilot.bad_link import BadLink, LinkFaults
    from wisar_sim.autopilot.conversation import Conversation

    rng = np.random.default_rng(0)
    old, new = _mission(10, north=56.0), _mission(64, altitude=77.0)
    faults = LinkFaults(loss=0.05, duplication=0.05, reordering=0.05, delay_s=0.02, jitter_s=0.02)
    outcomes: Counter[str] = Counter()
    profiles = ("px4", "ardupilot", "mavsdk")
    for seed in range(CUTS):
        server = _server(profiles[seed % 3])
        server.lists[0] = _stored(old)
        talk = Conversation(server, BadLink(faults, 2 * seed), BadLink(faults, 2 * seed + 1))
        talk.now = 60.0
        transfer = _transfer(new, server)
        if talk.run(transfer, until=talk.now + rng.uniform(0.0, _LATEST_CUT_S)):
            outcomes["ended_before_the_cut"] += 1
        talk.cut()
        talk.go_on(transfer)
        talk.settle(60.0)
        result, held = transfer.result, _held(server.lists[0], old, new)
        assert result is not None
        in_place = held is _Held.OTHER and profiles[seed % 3] == "ardupilot"
        outcomes["mixed_in_place" if in_place else f"{held.name.lower()}_held"] += 1
        wrong = (result.verified and held is not _Held.NEW) or (
            result.old_counts and held is not _Held.OLD
        )
        outcomes["told_wrong"] += wrong or not (result.verified or result.error)
    return BenchRow(
        name="old_mission_intact_after_cut",
        unit=(
            f"of {CUTS} uploads cut told the operator wrong, or left a mission neither old "
            f"({outcomes['old_held']}) nor new ({outcomes['new_held']}) on an autopilot that does "
            f"not overwrite it in place ({outcomes['mixed_in_place']} mixtures on those that do)"
        ),
        ours=outcomes["other_held"] + outcomes["told_wrong"],
        details={"cuts": CUTS, **dict(outcomes), "profiles": profiles},
    )


# -- hostile bytes -----------------------------------------------------------------------------


class _Fuzzer:
    """Makes frames that are no messages, and messages that are none of our business."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._codec = Codec(200, 200)
        self._seeds = [self._codec.encode(m) for m in self._messages()]

    @staticmethod
    def _messages() -> Iterator[Message]:
        for seq in range(4):
            yield item_message(MissionItem.at(16, 57.0, -4.0, 40.0), seq, 0, _VEHICLE)
            yield mav.MAVLink_mission_request_int_message(245, 190, seq, 0)
        yield mav.MAVLink_mission_count_message(1, 1, 64, 0)
        yield mav.MAVLink_mission_ack_message(245, 190, 0, 0)
        yield mav.MAVLink_mission_clear_all_message(1, 1, 255)
        yield mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        yield mav.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)

    def noise(self) -> bytes:
        """Return random bytes that begin like a frame half of the time."""
        data = self._rng.bytes(int(self._rng.integers(1, 120)))
        return b"\xfd" + data if self._rng.random() < 0.5 else data

    def mutated(self) -> bytes:
        """Return a real frame with some bytes changed, cut off or put in."""
        frame = bytearray(self._seeds[int(self._rng.integers(len(self._seeds)))])
        for _ in range(int(self._rng.integers(1, 6))):
            at = int(self._rng.integers(len(frame)))
            frame[at] ^= int(self._rng.integers(1, 256))
        kind = self._rng.random()
        if kind < 0.2:
            del frame[int(self._rng.integers(1, len(frame))) :]
        elif kind < 0.3:
            frame[5:5] = self._rng.bytes(3)
        return bytes(frame)

    def foreign(self) -> bytes:
        """Return a sound frame with random content, from a stranger to a stranger."""
        rng = self._rng
        kinds = (
            mav.MAVLink_mission_count_message(77, 7, int(rng.integers(65536)), 0),
            mav.MAVLink_mission_ack_message(77, 7, int(rng.integers(20)), int(rng.integers(256))),
            mav.MAVLink_mission_clear_all_message(77, 7, 255),
            mav.MAVLink_command_long_message(77, 7, int(rng.integers(65536)), 0, *rng.random(7)),
            mav.MAVLink_mission_request_int_message(77, 7, int(rng.integers(65536)), 0),
        )
        return self._codec.encode(kinds[int(rng.integers(len(kinds)))])


def _resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _fuzz_row() -> BenchRow:
    from wisar_planner.pdm.geodesy import GeoOrigin
    from wisar_sim.autopilot.autopilot import Autopilot
    from wisar_sim.autopilot.profile import PROFILES

    autopilot = Autopilot(PROFILES["px4"], GeoOrigin(57.0, -4.0))
    autopilot.tick(0.0)
    autopilot.missions.lists[0] = _stored(_mission(64))
    session = Session(Address(245, 190), "fuzz")
    ground, vehicle = Codec(245, 190), Codec(1, 1)
    for message in autopilot.tick(5.0):
        for heard in ground.decode(vehicle.encode(message))[0]:
            session.receive(heard, 5.0)
    upload = Upload(
        _mission(64).items,
        MissionKind.MISSION,
        _VEHICLE,
        dialect_of(mav.MAV_AUTOPILOT_PX4),
        link=LinkEstimates().sending,
    )
    session.begin(upload, 5.0)

    def state() -> tuple[object, ...]:
        flying = autopilot.vehicle
        return (
            copy.copy(autopilot.missions.lists),
            flying.armed,
            flying.mode,
            flying.current,
            session.vehicle,
            upload.items_sent,
            upload.end,
        )

    fuzzer = _Fuzzer(0)
    makers = (fuzzer.noise, fuzzer.mutated, fuzzer.mutated, fuzzer.mutated, fuzzer.foreign)
    before, changed, answered, crashes = state(), 0, 0, 0
    sound: Counter[str] = Counter()
    warmed_up = 0.0
    began = time.perf_counter()
    for number in range(FRAMES):
        if number == FRAMES // 10:
            warmed_up = _resident_mib()
        make = makers[number % len(makers)]
        frame = make()
        for codec, receive in ((vehicle, autopilot.receive), (ground, session.receive)):
            try:
                for message in codec.decode(frame)[0]:
                    sound[make.__name__] += 1
                    answered += len(receive(message, 6.0))
            except Exception:  # what is counted here, whatever it is
                crashes += 1
        if number % 1000 == 0 and state() != before:
            changed += 1
            before = state()
    seconds = time.perf_counter() - began
    changed += state() != before
    growth = _resident_mib() - warmed_up
    return BenchRow(
        name="fuzz_frames",
        unit=f"state changes and crashes in {FRAMES:,} frames; memory grew {growth:.1f} MiB",
        ours=changed + crashes,
        details={
            "frames": FRAMES,
            "ends": "bridge and autopilot, each frame to both",
            "state_changes": changed,
            "answered": answered,
            "sound_but_foreign": sound["foreign"],
            "checksum_right_by_chance": sound["mutated"] + sound["noise"],
            "frames_per_s": FRAMES / seconds,
            "memory_growth_mib": growth,
            "crashes": crashes,
        },
    )


# -- speed -------------------------------------------------------------------------------------


@contextlib.contextmanager
def _sim_autopilot(profile: str, *options: str) -> Iterator[int]:
    """Start a simulated autopilot on a free port of 127.0.0.1; yield the port."""
    command = [sys.executable, "-m", "wisar_sim.autopilot", "--profile", profile]
    command += ["--connection", "udpin:127.0.0.1:0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            if not select.select([process.stdout], [], [], 120.0)[0]:
                raise TimeoutError("sim_autopilot does not start")
            yield int(process.stdout.readline().rsplit(":", 1)[1])
        finally:
            process.terminate()


def _has_mavsdk() -> bool:
    try:
        import mavsdk  # noqa: F401
    except ImportError:
        return False
    return True


_mavsdk_log = threading.Lock()


@functools.cache
def _silence_mavsdk() -> None:
    """Drop MAVSDK's warnings about the bad link: once, as a second call frees the first's."""
    from mavsdk.logging import log_subscribe

    log_subscribe(lambda *_: True)


@contextlib.contextmanager
def _mavsdk_client(port: int) -> Iterator[Callable[[Mission], bool] | None]:
    """Connect MAVSDK's client; yield a function that uploads, or None if it finds no vehicle."""
    import mavsdk
    from mavsdk.plugins import mission_raw

    with _mavsdk_log:
        _silence_mavsdk()
    kind = mavsdk.ComponentType.GROUND_STATION
    with mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind)) as sdk:
        sdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        system = sdk.first_autopilot(30.0)
        if system is None:
            yield None
            return
        raw = mission_raw.MissionRaw(system)

        def upload(mission: Mission) -> bool:
            items = [
                mission_raw.MissionItem(
                    n, i.frame, i.command, int(n == 0), 1, *i.params, i.x, i.y, i.z, 0
                )
                for n, i in enumerate(mission.items)
            ]
            try:
                raw.upload_mission(items)
            except mission_raw.MissionRawError:
                return False
            return True

        yield upload


class _BareClient:
    """Our library without thread and read-back, to time the upload alone."""

    def __init__(self, port: int) -> None:
        self._link = Link(f"udpout:127.0.0.1:{port}", Codec(246, 190))
        self._session = Session(Address(246, 190), "bench")
        self._links = LinkEstimates()

    def wait(self) -> None:
        """Wait for the vehicle's heartbeat."""
        deadline = time.monotonic() + 60.0
        while self._session.vehicle is None:
            if time.monotonic() > deadline:
                raise TimeoutError("no heartbeat")
            self._turn(0.1)

    def _turn(self, timeout: float) -> None:
        self._link.open()
        for message in self._session.tick(time.monotonic()):
            self._link.send(message)
        for message in self._link.receive(timeout):
            for answer in self._session.receive(message, time.monotonic()):
                self._link.send(answer)

    def upload(self, mission: Mission) -> float:
        """Upload and return the seconds until the acknowledgement."""
        exchange = Upload(
            mission.items,
            MissionKind.MISSION,
            _VEHICLE,
            dialect_of(mav.MAV_AUTOPILOT_PX4),
            link=self._links.sending,
        )
        began = time.perf_counter()
        for message in self._session.begin(exchange, time.monotonic()):
            self._link.send(message)
        while not exchange.done:
            self._turn(max(self._session.deadline - time.monotonic(), 0.0))
        if exchange.end is not UploadEnd.ACCEPTED:
            raise RuntimeError(f"upload on a clean link: {exchange.end}")
        return time.perf_counter() - began

    def close(self) -> None:
        """Close the connection."""
        self._link.close()


def _speed_row() -> BenchRow:
    """Time the same upload by three clients in turn, each on an autopilot of its own."""
    mission = _mission(64)
    alone, verified, theirs = [], [], []
    with contextlib.ExitStack() as stack:
        ports = [stack.enter_context(_sim_autopilot("px4")) for _ in range(3)]
        bare = _BareClient(ports[0])
        stack.callback(bare.close)
        bare.wait()
        client = stack.enter_context(MissionClient(f"udpout:127.0.0.1:{ports[1]}"))
        client.wait_heartbeat(60.0)
        peer = stack.enter_context(_mavsdk_client(ports[2])) if _has_mavsdk() else None
        for _ in range(_CLEAN_REPETITIONS):
            alone.append(bare.upload(mission))
            result = client.upload(mission, kinds=_ONLY_MISSION)
            assert result.verified, result.error
            verified.append(result.elapsed_s)
            if peer is not None:
                began = time.perf_counter()
                assert peer(mission)
                theirs.append(time.perf_counter() - began)
    ours = statistics.median(alone)
    peer_s = statistics.median(theirs) if theirs else None
    return BenchRow(
        name="upload_64_items_clean_loopback",
        unit="s",
        ours=ours,
        peer=peer_s,
        peer_name=f"MAVSDK {version('mavsdk')} (C++), not verified" if theirs else None,
        ratio=peer_s / ours if peer_s else None,
        details={
            "repetitions": _CLEAN_REPETITIONS,
            "ours_with_read_back_s": statistics.median(verified),
            "what": "until the acknowledgement, on the simulated px4",
        },
    )


ROWS: dict[str, Callable[[], BenchRow]] = {
    **{
        f"mission_upload_loss_{percent}": lambda percent=percent: _loss_row(percent)  # type: ignore[misc]
        for percent in (0, 10, 30, 50)
    },
    "old_mission_intact_after_cut": _cut_row,
    "fuzz_frames": _fuzz_row,
    "upload_64_items_clean_loopback": _speed_row,
}
