"""The simulated autopilot as a process of its own, with our client at the other end."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.client import LinkError, MissionClient
from wisar_planner.mavlink.dialect import PX4
from wisar_planner.mavlink.link_estimate import RetryPolicy
from wisar_planner.mavlink.mission import MissionKind, build_mission
from wisar_planner.mavlink.outcome import UploadCode
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_sim.autopilot.cli import main

FRAME = LocalFrame(GeoOrigin(57.0, -4.0))
MISSION = build_mission(
    FRAME.to_geodetic([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0]]), altitude_m=20.0, speed=8.0
)


class Process:
    """A running sim_autopilot on a free port."""

    def __init__(self, *options, connection="udpin:127.0.0.1:0"):
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "wisar_sim.autopilot", "--connection", connection, *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        readable, _, _ = select.select([self.popen.stdout], [], [], 60.0)
        assert readable, "sim_autopilot does not start"
        self.line = self.popen.stdout.readline()
        assert "ready on" in self.line, self.popen.stderr.read()
        self.port = int(re.search(r":(\d+)\s*$", self.line)[1])

    def stop(self, number=signal.SIGTERM):
        if self.popen.poll() is None:
            self.popen.send_signal(number)
        return self.popen.wait(10.0)


@pytest.fixture
def start():
    running = []

    def start(*options, **more):
        running.append(Process(*options, **more))
        return running[-1]

    yield start
    for process in running:
        process.stop()
        process.popen.stdout.close()
        process.popen.stderr.close()


@pytest.fixture(scope="module")
def px4():
    """One autopilot for all tests that need no special one."""
    process = Process("--speed-up", "20", "--delay-s", "0.005")
    yield process
    process.stop()
    process.popen.stdout.close()
    process.popen.stderr.close()


def client_of(process, **options):
    return MissionClient(f"udpout:127.0.0.1:{process.port}", **options)


def wait_for(condition, timeout=20.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.02)


def test_it_ends_when_interrupted(start):
    assert start().stop(signal.SIGINT) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--home", "57"), "--home"),
        (("--home", "95,0"), "latitude"),
        (("--home=57,-4,9e9",), "--home"),
        (("--home=57,-4,-inf",), "altitude"),
        (("--speed-up", "0"), "--speed-up"),
        (("--speed-up", "1e9"), "--speed-up"),
        (("--speed-up", "inf"), "--speed-up"),
        (("--speed-up", "nan"), "--speed-up"),
        (("--system", "300"), "--system"),
        (("--system", "0"), "--system"),
        (("--component", "-1"), "--component"),
        (("--component", "256"), "--component"),
        (("--seed", "-1"), "--seed"),
        (("--wind", "nan,0"), "--wind"),
        (("--wind", "0,1e400"), "--wind"),
        (("--wind", "400,0"), "--wind"),
        (("--loss", "2"), "loss"),
        ((), "connection"),
        (("--key-file", "/nonexistent"), "key_file"),
        (("--storage", "/nonexistent/lists.json"), "--storage"),
        (("--storage", "/"), "--storage"),
    ],
)
def test_mistakes_are_told_in_one_line(options, words, capsys):
    # The connection cannot be opened: a mistake that is overlooked does not serve for ever.
    assert main(("--connection", "nonsense", *options)) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_port_in_use_is_told(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        assert main(["--connection", f"udpin:127.0.0.1:{taken.getsockname()[1]}"]) == 2
    assert "in use" in capsys.readouterr().err


def test_the_extremes_that_are_taken_are_served_and_end_when_interrupted(start):
    ids = ("--system", "255", "--component", "255", "--speed-up", "1000")
    process = start(*ids, "--home=57,-4,2e6", "--wind", "300,-300", "--profile", "mavsdk")
    with client_of(process) as client:
        client.wait_heartbeat()
        client.arm()
        wait_for(lambda: client.vehicle.armed)
        assert process.popen.poll() is None
    assert process.stop(signal.SIGINT) == 0


@pytest.mark.parametrize("profile", ["ardupilot"])
def test_upload_verify_and_fly_to_the_end(start, profile):
    with client_of(start("--profile", profile, "--speed-up", "30")) as client:
        vehicle = client.wait_heartbeat()
        assert not vehicle.armed
        progress = []
        result = client.upload(MISSION, on_progress=progress.append)
        assert result.verified, result.error
        assert progress
        assert client.vehicle.armed is False  # uploading arms nothing
        found = client.download()
        assert vehicle.dialect.differences(MissionKind.MISSION, MISSION.items, found) == ()
        with pytest.raises(LinkError, match="start of the mission"):
            client.start_mission()
        client.arm()
        client.start_mission()
        wait_for(lambda: client.vehicle.armed)
        wait_for(lambda: client.vehicle.reached_item == len(MISSION.items) - 1)
        wait_for(lambda: not client.vehicle.armed)
        assert client.vehicle.relative_altitude == pytest.approx(0.0, abs=0.5)
        # It still is in AUTO, where it cannot be armed: the next flight starts all the same.
        client.arm()
        client.start_mission()
        wait_for(lambda: client.vehicle.relative_altitude > 1.0)
        client.arm()  # changes nothing in flight
        wait_for(lambda: client.vehicle.current_item == len(MISSION.items) - 1)


def test_nothing_starts_that_is_not_armed(start):
    """PX4 would arm by itself; and for a second after an upload it denies the start."""
    with client_of(start("--profile", "px4")) as client:
        client.wait_heartbeat()
        assert client.upload(MISSION).verified
        time.sleep(1.2)
        with pytest.raises(LinkError, match="arm it first"):
            client.start_mission()
        time.sleep(1.2)
        assert not client.vehicle.armed
        assert client.upload(MISSION).verified
        client.arm()
        client.start_mission()
        wait_for(lambda: client.vehicle.relative_altitude > 1.0)


def test_pause_and_return(px4):
    with client_of(px4) as client:
        client.wait_heartbeat()
        assert client.upload(MISSION).verified
        client.arm()
        client.start_mission()
        wait_for(lambda: client.vehicle.armed and (client.vehicle.current_item or 0) >= 2)
        client.pause()
        current = client.vehicle.current_item
        time.sleep(1.0)
        assert client.vehicle.current_item == current
        client.resume()
        client.return_to_launch()
        wait_for(lambda: not client.vehicle.armed)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_mission_that_is_flown_is_replaced_only_in_a_hold(start, profile):
    higher = build_mission(MISSION.waypoints[:, :2], altitude_m=35.0, speed=8.0)
    with client_of(start("--profile", profile, "--speed-up", "2")) as client:
        client.wait_heartbeat()
        assert client.upload(MISSION).verified
        client.arm()
        client.start_mission()
        wait_for(lambda: (client.vehicle.current_item or 0) >= 3)
        refused = client.upload(higher)
        assert refused.code is UploadCode.REFUSED_BEFORE
        assert "call pause first" in refused.error
        client.pause()
        held = client.vehicle.current_item
        assert client.upload(higher).verified
        assert client.vehicle.armed
        assert held >= 3
        client.start_mission()  # from the first item on
        wait_for(lambda: client.vehicle.relative_altitude > 30.0)
        assert client.vehicle.current_item <= 2


def test_two_clients_at_once_each_get_their_answer(px4):
    results = []

    def upload(system, altitude):
        wanted = build_mission(MISSION.waypoints[:, :2], altitude_m=altitude)
        with client_of(px4, system=system) as client:
            client.wait_heartbeat()
            results.append((client.upload(wanted), altitude))

    threads = [threading.Thread(target=upload, args=args) for args in ((245, 20.0), (246, 30.0))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert len(results) == 2
    for result, _ in results:
        # The one that came later may have replaced the other's between sending and reading back.
        assert result.verified or result.code is UploadCode.DIFFERENT
    assert any(result.verified for result, _ in results)


def test_a_vehicle_that_comes_back_is_noticed(start):
    states = []
    first = start(connection="udpin:127.0.0.1:0")
    with client_of(first, on_link=lambda status: states.append(status.connected)) as client:
        client.wait_heartbeat()
        first.stop()
        wait_for(lambda: states == [True, False])
        assert client.upload(MISSION).code is UploadCode.NO_LINK
        with pytest.raises(LinkError, match="no vehicle"):
            client.pause()
        start(connection=f"udpin:127.0.0.1:{first.port}")
        wait_for(lambda: states == [True, False, True])
        assert client.upload(MISSION).verified


def test_missions_survive_a_restart(start, tmp_path):
    storage = str(tmp_path / "lists.json")
    process = start("--storage", storage)
    square = FRAME.to_geodetic([[-50.0, -50.0], [80.0, -50.0], [80.0, 80.0], [-50.0, 80.0]])
    wanted = build_mission(MISSION.waypoints[:, :2], altitude_m=20.0, inclusions=[square])
    with client_of(process) as client:
        client.wait_heartbeat()
        assert client.upload(wanted).verified
    time.sleep(0.1)
    assert process.stop(signal.SIGTERM) == 0
    with client_of(start("--storage", storage)) as client:
        client.wait_heartbeat()
        assert len(client.download()) == len(wanted.items)
        fence = client.download(MissionKind.FENCE)
        assert PX4.differences(MissionKind.FENCE, wanted.fence, fence) == ()


def test_a_mission_that_cannot_be_stored_is_not_acknowledged(start, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    process = start("--storage", str(folder / "lists.json"))
    with client_of(process, policy=RetryPolicy(max_tries=2, patience_s=1.0)) as client:
        client.wait_heartbeat()
        folder.rmdir()
        assert not client.upload(MISSION).verified
        assert process.popen.wait(10.0) == 1  # not as for arguments, which ends a launch
    error = process.popen.stderr.read()
    assert "--storage" in error
    assert "connection" not in error
    assert error.count("\n") == 1


def test_a_bad_link_over_real_sockets(start):
    options = "--loss 0.2 --duplication 0.1 --reordering 0.1 --corruption 0.02 --jitter-s 0.01"
    with client_of(start(*options.split(), "--seed", "3")) as client:
        client.wait_heartbeat()
        assert client.upload(MISSION, kinds=[MissionKind.MISSION]).verified


def test_cancelling_an_upload(px4):
    long = build_mission(
        np.column_stack([57.0 + 1e-6 * np.arange(4000), np.full(4000, -4.0)]), altitude_m=20.0
    )
    with client_of(px4) as client:
        client.wait_heartbeat()
        assert client.upload(MISSION).verified
        seen = []
        result = client.upload(long, on_progress=seen.append, should_cancel=lambda: len(seen) > 10)
        assert result.code is UploadCode.CANCELLED
        assert len(client.download()) == len(MISSION.items)


def test_one_upload_at_a_time_and_closing_ends_it(px4):
    long = build_mission(
        np.column_stack([57.0 + 1e-6 * np.arange(4000), np.full(4000, -4.0)]), altitude_m=20.0
    )
    results = []
    client = client_of(px4)
    client.wait_heartbeat()
    thread = threading.Thread(target=lambda: results.append(client.upload(long)))
    thread.start()
    time.sleep(0.5)
    assert client.upload(MISSION).code is UploadCode.BUSY
    client.close()
    thread.join(5.0)
    assert results[0].code is UploadCode.CANCELLED
    client.close()


def test_closing_in_the_middle_of_an_upload_puts_an_ardupilots_mission_back(start):
    long = build_mission(
        np.column_stack([57.0 + 1e-6 * np.arange(400), np.full(400, -4.0)]), altitude_m=20.0
    )
    process = start("--profile", "ardupilot", "--delay-s", "0.005")
    results, sent = [], threading.Event()

    def progress(now):
        if now.items_sent > 10:
            sent.set()

    client = client_of(process)
    client.wait_heartbeat()
    assert client.upload(MISSION).verified
    thread = threading.Thread(
        target=lambda: results.append(client.upload(long, on_progress=progress))
    )
    thread.start()
    assert sent.wait(20.0)
    client.close()
    thread.join(5.0)
    assert results[0].code is UploadCode.CANCELLED
    assert "The old mission was put back" in results[0].error
    with client_of(process) as other:
        other.wait_heartbeat()
        found = other.download()
        assert other.vehicle.dialect.differences(MissionKind.MISSION, MISSION.items, found) == ()


def test_a_mixture_is_not_started(start):
    process = start("--profile", "ardupilot", "--delay-s", "0.02")
    with client_of(process, policy=RetryPolicy(max_tries=12, patience_s=4.0)) as client:
        client.wait_heartbeat()
        wait_for(lambda: client.upload(MISSION).verified)  # it has no space just after its start
        seen = []

        def progress(now):
            if now.items_sent > 2 and not seen:
                seen.append(now)
                os.kill(process.popen.pid, signal.SIGSTOP)  # and its link with it

        result = client.upload(MISSION, on_progress=progress)
        os.kill(process.popen.pid, signal.SIGCONT)
        assert not result.old_counts
        assert "do not fly it; upload again" in result.error
        wait_for(lambda: client.link_status.connected)
        client.arm()
        with pytest.raises(LinkError, match="upload again first"):
            client.start_mission()
        wait_for(lambda: client.upload(MISSION).verified)  # once it has given the last one up
        client.start_mission()


# -- signing -------------------------------------------------------------------------------------


@pytest.fixture
def keys(tmp_path):
    paths = []
    for n in range(2):
        path = tmp_path / f"key{n}"
        path.write_bytes(bytes([n]) * 32)
        path.chmod(0o600)
        paths.append(path)
    return paths


def test_with_the_right_key_everything_works(start, keys):
    with client_of(start("--key-file", str(keys[0])), key_file=keys[0]) as client:
        client.wait_heartbeat()
        assert client.upload(MISSION).verified
        assert client.counters.unsigned == client.counters.badly_signed == 0


def test_an_autopilot_that_does_not_sign_is_not_heard(start, keys):
    with client_of(start(), key_file=keys[0]) as client:
        wait_for(lambda: client.counters.unsigned > 3)
        assert client.vehicle is None


def test_an_autopilot_with_another_key_neither_hears_nor_is_heard(start, keys):
    process = start("--key-file", str(keys[1]))
    with client_of(process, key_file=keys[0]) as client:
        with client_of(process, key_file=keys[1]) as other:
            other.wait_heartbeat()  # it is there
        with pytest.raises(LinkError, match="no heartbeat"):
            client.wait_heartbeat(1.5)
        assert client.vehicle is None


def test_ids_are_respected(start):
    process = start("--system", "7")
    with client_of(process, target_system=8) as wrong, pytest.raises(LinkError):
        wrong.wait_heartbeat(1.5)
    with client_of(process, target_system=7, target_component=1) as right:
        assert right.wait_heartbeat().system == 7


# -- the terminal end ----------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs pseudo terminals")
def test_a_serial_line(start):
    pytest.importorskip("serial")
    import tty

    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    process = start(connection="tcpin:127.0.0.1:0")
    plug = socket.create_connection(("127.0.0.1", process.port))
    stopped = threading.Event()

    def wire():
        while not stopped.is_set():
            for source in select.select([ours, plug], [], [], 0.1)[0]:
                if source is plug:
                    os.write(ours, plug.recv(4096))
                else:
                    plug.sendall(os.read(ours, 4096))

    thread = threading.Thread(target=wire)
    thread.start()
    try:
        with MissionClient(f"serial:{name}:57600") as client:
            client.wait_heartbeat()
            assert client.upload(MISSION).verified
    finally:
        stopped.set()
        thread.join()
        plug.close()
        os.close(ours)
        os.close(theirs)


def test_heartbeats_of_ground_stations_are_no_vehicles():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with MissionClient(f"udpout:127.0.0.1:{other.getsockname()[1]}") as client:
            _, address = other.recvfrom(300)
            gcs = mav.MAVLink(None, 9, 190)
            beat = mav.MAVLink_heartbeat_message(
                mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
            )
            other.sendto(bytes(beat.pack(gcs)), address)
            with pytest.raises(LinkError):
                client.wait_heartbeat(0.5)
            assert client.counters.received == 1
