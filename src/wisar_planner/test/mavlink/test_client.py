"""The client's thread: what goes wrong in it ends in words, and never in a silence."""

import contextlib
import socket
import threading
import time

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.client import LinkError, MissionClient
from wisar_planner.mavlink.codec import Codec
from wisar_planner.mavlink.mission import MissionKind, build_mission
from wisar_planner.mavlink.outcome import UploadCode

MISSION = build_mission([(57.0, -4.0), (57.001, -4.0)], altitude_m=40.0, speed=5.0)


class FakeVehicle:
    """A vehicle that beats, and otherwise does what a test says.

    `answer` is called with the vehicle and every message that comes, and returns the answers.
    """

    def __init__(
        self, answer=lambda vehicle, message: [], autopilot=mav.MAV_AUTOPILOT_PX4, **state
    ):
        self.answer = answer
        self.autopilot = autopilot
        self.base_mode, self.custom_mode = 0, 0
        self.status = mav.MAV_STATE_STANDBY
        self.beats = True
        self.heard = []
        self.told = []  # what is to be sent
        for name, value in state.items():
            setattr(self, name, value)
        self._codec = Codec(1, 1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self.connection = f"udpout:127.0.0.1:{self._socket.getsockname()[1]}"
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run)

    @property
    def armed(self):
        return bool(self.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)

    @armed.setter
    def armed(self, armed):
        self.base_mode = mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0

    def commands(self, code=None):
        """The COMMAND_LONG heard, other than requests for telemetry."""
        sent = [m for m in self.heard if m.get_type() == "COMMAND_LONG"]
        sent = [m for m in sent if m.command != mav.MAV_CMD_SET_MESSAGE_INTERVAL]
        return [m for m in sent if code in (None, m.command)]

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stopped.set()
        self._thread.join()
        self._socket.close()

    def _run(self):
        peer, beat_at = None, 0.0
        while not self._stopped.is_set():
            now = time.monotonic()
            if peer is not None and self.beats and now >= beat_at:
                beat_at = now + 0.1
                beat = mav.MAVLink_heartbeat_message(
                    mav.MAV_TYPE_QUADROTOR,
                    self.autopilot,
                    self.base_mode,
                    self.custom_mode,
                    self.status,
                    3,
                )
                self._socket.sendto(self._codec.encode(beat), peer)
            with contextlib.suppress(TimeoutError):
                data, peer = self._socket.recvfrom(65_535)
                for message in self._codec.decode(data)[0]:
                    self.heard.append(message)
                    self.told += self.answer(self, message)
            while peer is not None and self.told:
                self._socket.sendto(self._codec.encode(self.told.pop(0)), peer)


def run(call, *args, **options):
    """Run a call in a thread that must end; return what it returned or raised."""
    out = []

    def work():
        try:
            out.append(call(*args, **options))
        except Exception as error:
            out.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(15.0)
    assert out, "the call waits for ever"
    return out[0]


# -- mistakes inside ----------------------------------------------------------------------------


@pytest.mark.parametrize("connection", ["udpout:a..b:14550", "serial:\0:57600"])
def test_a_connection_that_cannot_be_is_told_and_tried_again(connection):
    states = []
    with MissionClient(connection, on_link=states.append) as client:
        error = run(client.wait_heartbeat, 0.5)
        assert isinstance(error, LinkError)
        assert client._link._thread.is_alive()
        assert connection in client.link_status.text
        assert states
        assert run(client.upload, MISSION).code is UploadCode.NO_LINK


def test_who_cannot_be_asked_whether_to_cancel_has_cancelled(caplog):
    def gone():
        raise RuntimeError("the goal handle is gone")

    with FakeVehicle() as vehicle, MissionClient(vehicle.connection) as client:
        client.wait_heartbeat()
        result = run(client.upload, MISSION, should_cancel=gone)
        assert result.code is UploadCode.CANCELLED
        assert "the goal handle is gone" in caplog.text
        assert client.link_status.connected


def test_an_error_inside_ends_every_call_in_words(monkeypatch):
    with FakeVehicle() as vehicle, MissionClient(vehicle.connection) as client:
        client.wait_heartbeat()
        began = threading.Event()
        results = []

        def upload():
            results.append(client.upload(MISSION, should_cancel=lambda: began.set() or False))

        thread = threading.Thread(target=upload, daemon=True)
        thread.start()
        assert began.wait(5.0)

        def fail(*_):
            raise RuntimeError("a fault")

        monkeypatch.setattr(client._link._session, "tick", fail)
        thread.join(5.0)
        assert results[0].code is UploadCode.NO_LINK
        assert "a fault" in results[0].error
        assert not client.link_status.connected
        assert "a fault" in client.link_status.text
        for call in (client.download, client.pause, client.wait_heartbeat):
            error = run(call)
            assert isinstance(error, LinkError)
            assert "a fault" in str(error)
        assert run(client.upload, MISSION).code is UploadCode.NO_LINK


# -- requests beside a transfer -------------------------------------------------------------------


def acknowledge(vehicle, message, result=mav.MAV_RESULT_ACCEPTED):
    """Acknowledge every command."""
    if message.get_type() != "COMMAND_LONG":
        return []
    return [mav.MAVLink_command_ack_message(message.command, result, 0, 0, 245, 190)]


def wait_for(condition, timeout=10.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.01)


@contextlib.contextmanager
def in_background(call, *args):
    """Run a call beside the block; gives a list into which its end goes."""
    out = []

    def work():
        try:
            out.append(call(*args))
        except Exception as error:
            out.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    yield out
    thread.join(15.0)
    assert out, "the call waits for ever"


def generic(answer):
    return FakeVehicle(answer, autopilot=mav.MAV_AUTOPILOT_GENERIC)


def test_a_return_does_not_wait_for_an_upload():
    with generic(acknowledge) as vehicle, MissionClient(vehicle.connection) as client:
        client.wait_heartbeat()
        done = threading.Event()
        upload = lambda: client.upload(MISSION, should_cancel=done.is_set)  # noqa: E731
        with in_background(upload) as result:
            wait_for(lambda: any("MISSION_" in m.get_type() for m in vehicle.heard))
            began = time.monotonic()
            client.return_to_launch()
            assert time.monotonic() - began < 3.0
            assert result == []  # the upload goes on
            done.set()
        assert result[0].code is UploadCode.CANCELLED


def test_a_return_does_not_wait_for_another_request():
    def only_returns(vehicle, message):
        if getattr(message, "command", None) == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return acknowledge(vehicle, message)
        return []

    with generic(only_returns) as vehicle, MissionClient(vehicle.connection) as client:
        client.wait_heartbeat()
        with in_background(client.pause) as paused:
            wait_for(lambda: vehicle.commands())
            began = time.monotonic()
            client.return_to_launch()
            assert time.monotonic() - began < 3.0
        assert "return to launch was asked for" in str(paused[0])
        sent = len(vehicle.commands(mav.MAV_CMD_DO_PAUSE_CONTINUE))
        time.sleep(1.0)
        assert len(vehicle.commands(mav.MAV_CMD_DO_PAUSE_CONTINUE)) == sent


def test_a_second_request_is_refused_while_one_is_in_progress():
    """Requests that wait would take the threads that a cancel or a return needs."""
    with generic(lambda *_: []) as vehicle, MissionClient(vehicle.connection) as client:
        client.wait_heartbeat()
        with in_background(client.disarm) as disarmed:
            wait_for(lambda: vehicle.commands())
            for call in (client.resume, client.arm, client.disarm):
                with pytest.raises(LinkError, match="in progress"):
                    call()
            assert disarmed == []
            with in_background(client.pause) as paused:
                wait_for(lambda: vehicle.commands(mav.MAV_CMD_DO_PAUSE_CONTINUE))
                vehicle.answer = acknowledge
        assert paused == [None]
        assert "pause was asked for" in str(disarmed[0])


# -- requests that are not made -------------------------------------------------------------------

HOLD, IN_MISSION, RETURNING, TAKEOFF = (4 << 16 | sub << 24 for sub in (3, 4, 5, 2))


@contextlib.contextmanager
def talking_to(*args, **state):
    """A vehicle in a state, and a client that has heard of it."""
    with FakeVehicle(*args, **state) as vehicle, MissionClient(vehicle.connection) as client:
        client.wait_heartbeat()
        yield vehicle, client


def test_a_start_ends_when_the_vehicle_is_disarmed_meanwhile():
    with talking_to(armed=True, custom_mode=HOLD) as (vehicle, client):
        with in_background(client.start_mission) as started:
            wait_for(lambda: vehicle.commands(mav.MAV_CMD_MISSION_START))
            vehicle.armed = False
        assert "no longer armed; start again" in str(started[0])
        sent = len(vehicle.commands())
        time.sleep(1.0)
        assert len(vehicle.commands()) == sent


@pytest.mark.parametrize("name", ["arm", "start_mission"])
def test_arming_and_start_are_given_up_soon(name):
    with talking_to(armed=name != "arm", custom_mode=HOLD) as (_, client):
        began = time.monotonic()
        with pytest.raises(LinkError, match="does not answer"):
            getattr(client, name)()
        assert time.monotonic() - began < 5.0


def test_arming_is_given_up_soon_where_a_mode_is_shown_late():
    """A copter of ArduPilot in RTL: GUIDED is shown after 2 s, arming is never answered."""
    asked_at = []

    def guided_later(vehicle, message):
        if asked_at and time.monotonic() - asked_at[0] > 2.0:
            vehicle.custom_mode = 4
        if message.get_type() == "COMMAND_LONG" and message.command == mav.MAV_CMD_DO_SET_MODE:
            asked_at.append(time.monotonic())
            return [mav.MAVLink_command_ack_message(message.command, mav.MAV_RESULT_ACCEPTED)]
        return []

    with talking_to(guided_later, autopilot=mav.MAV_AUTOPILOT_ARDUPILOTMEGA, custom_mode=6) as (
        vehicle,
        client,
    ):
        began = time.monotonic()
        with pytest.raises(LinkError, match="does not answer"):
            client.arm()
        assert time.monotonic() - began < 3.5
        assert vehicle.commands(mav.MAV_CMD_COMPONENT_ARM_DISARM)


@pytest.mark.parametrize("mode", [IN_MISSION, RETURNING, TAKEOFF])
def test_a_vehicle_that_would_fly_off_is_not_armed(mode):
    """It is put into hold first; one that stays in the mode is not armed."""
    with talking_to(acknowledge, custom_mode=mode) as (vehicle, client):
        with pytest.raises(LinkError, match="acknowledged, but"):
            client.arm()
        assert {m.command for m in vehicle.commands()} == {mav.MAV_CMD_DO_SET_MODE}
        assert not vehicle.armed


def test_a_failsafe_on_the_ground_does_not_let_an_ardupilot_resume():
    state = {"autopilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA, "armed": True, "custom_mode": 17}
    with talking_to(acknowledge, **state) as (vehicle, client):
        wait_for(lambda: client.vehicle.landed)
        vehicle.status = mav.MAV_STATE_CRITICAL
        heard = client.vehicle.heard_at
        wait_for(lambda: client.vehicle.heard_at > heard + 0.3)
        with pytest.raises(LinkError, match="on the ground"):
            client.resume()


def test_resume_needs_an_armed_vehicle_in_the_air():
    with talking_to(acknowledge, custom_mode=HOLD) as (vehicle, client):
        with pytest.raises(LinkError, match="not armed"):
            client.resume()
        assert vehicle.commands() == []
    ardupilot = {"autopilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA, "custom_mode": 17}
    with talking_to(acknowledge, armed=True, **ardupilot) as (vehicle, client):
        with pytest.raises(LinkError, match="on the ground"):
            client.resume()
        assert vehicle.commands() == []
        vehicle.status = mav.MAV_STATE_ACTIVE
        wait_for(lambda: client.vehicle.landed is False)

        def obey(vehicle, message):
            if getattr(message, "command", 0) == mav.MAV_CMD_DO_SET_MODE:
                vehicle.custom_mode = int(message.param2)
            return acknowledge(vehicle, message)

        vehicle.answer = obey
        client.resume()
        assert vehicle.custom_mode == 3


def test_nothing_is_uploaded_to_a_vehicle_that_flies_its_mission():
    with talking_to(armed=True, custom_mode=IN_MISSION) as (vehicle, client):
        result = client.upload(MISSION)
        assert result.code is UploadCode.REFUSED_BEFORE
        assert "would fly the new one at once; call pause first" in result.error
        assert result.old_counts
        assert not any(m.get_type().startswith("MISSION_") for m in vehicle.heard)


def test_heights_above_terrain_are_not_sent_to_px4():
    above_terrain = build_mission([(57.0, -4.0)], altitude_m=40.0, altitude_frame="terrain")
    with talking_to(custom_mode=HOLD) as (vehicle, client):
        result = client.upload(above_terrain)
        assert result.code is UploadCode.REFUSED_BEFORE
        assert "takes no heights above terrain" in result.error
        assert not any(m.get_type().startswith("MISSION_") for m in vehicle.heard)


def test_a_vehicle_that_begins_its_mission_before_the_upload_is_left_alone():
    """Its fence is still being sent then; the mission is not sent any more."""

    def start_at_the_fence(vehicle, message):
        if message.get_type() != "MISSION_CLEAR_ALL":
            return []
        if not vehicle.armed:
            vehicle.armed, vehicle.custom_mode = True, IN_MISSION
            return []
        none_known = mav.MAV_MISSION_UNSUPPORTED
        ack = mav.MAVLink_mission_ack_message(245, 190, none_known, message.mission_type)
        return [ack] if client.vehicle.armed else []

    with talking_to(start_at_the_fence, custom_mode=HOLD) as (vehicle, client):
        result = client.upload(MISSION, kinds=list(MissionKind))
        assert result.code is UploadCode.REFUSED_BEFORE
        assert "call pause first" in result.error
        assert not any(m.get_type() == "MISSION_COUNT" for m in vehicle.heard)


def test_nothing_is_started_during_an_upload():
    with talking_to(acknowledge, armed=True, custom_mode=HOLD) as (vehicle, client):
        done = threading.Event()
        upload = lambda: client.upload(MISSION, should_cancel=done.is_set)  # noqa: E731
        with in_background(upload):
            wait_for(lambda: any("MISSION_" in m.get_type() for m in vehicle.heard))
            for call in (client.start_mission, client.resume):
                with pytest.raises(LinkError, match="upload is in progress"):
                    call()
            done.set()
        assert vehicle.commands() == []


@pytest.mark.parametrize("knows_command", [True, False])
def test_a_start_in_flight_on_ardupilot_begins_with_the_first_item(knows_command):
    def obey(vehicle, message):
        code, name = getattr(message, "command", 0), message.get_type()
        if name == "MISSION_SET_CURRENT":
            assert message.seq == 1  # 0 is home
            chosen.append(name)
            return [mav.MAVLink_mission_current_message(1)]
        if code == mav.MAV_CMD_DO_SET_MISSION_CURRENT:
            assert message.param1 == 1.0
            chosen.append(code)
            if not knows_command:
                return acknowledge(vehicle, message, mav.MAV_RESULT_UNSUPPORTED)
        if code == mav.MAV_CMD_DO_SET_MODE:
            assert chosen
            vehicle.custom_mode = int(message.param2)
        return acknowledge(vehicle, message)

    chosen = []
    state = {"autopilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA, "status": mav.MAV_STATE_ACTIVE}
    with talking_to(obey, armed=True, custom_mode=17, **state) as (vehicle, client):
        client.start_mission()
        assert vehicle.custom_mode == 3
        assert ("MISSION_SET_CURRENT" in chosen) is not knows_command


# -- a mission that is uploaded in flight ---------------------------------------------------------

BRAKE, AUTO = 17, 3


class Copter:
    """What a flying copter of ArduPilot answers: it takes modes and missions, and reads them out.

    Without `takes_items` it stops asking for them.
    """

    def __init__(self):
        self.held, self.wanted = (), 0
        self.takes_items = True

    def __call__(self, vehicle, message):
        name = message.get_type()
        if name == "COMMAND_LONG":
            if message.command == mav.MAV_CMD_DO_SET_MODE:
                vehicle.custom_mode = int(message.param2)
            return acknowledge(vehicle, message)
        if name == "MISSION_COUNT":
            self.held, self.wanted = (), message.count
            return self.ask() if self.takes_items else []
        if name == "MISSION_ITEM_INT" and message.seq == len(self.held):
            self.held = (*self.held, message)
            return self.ask()
        if name == "MISSION_REQUEST_LIST":
            return [mav.MAVLink_mission_count_message(245, 190, len(self.held))]
        if name == "MISSION_REQUEST_INT":
            item = self.held[message.seq]
            item.target_system, item.target_component = 245, 190
            return [item]
        return []

    def ask(self):
        if len(self.held) < self.wanted:
            return [mav.MAVLink_mission_request_int_message(245, 190, len(self.held))]
        return [mav.MAVLink_mission_ack_message(245, 190, mav.MAV_MISSION_ACCEPTED)]


@contextlib.contextmanager
def flying_copter(mode=BRAKE):
    state = {"autopilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA, "status": mav.MAV_STATE_ACTIVE}
    with talking_to(Copter(), armed=True, custom_mode=mode, **state) as (vehicle, client):
        yield vehicle, client


def test_a_mission_uploaded_in_a_pause_is_started_and_not_resumed():
    """ArduPilot would go on with the item of the old number, and leave out those before."""
    with flying_copter() as (vehicle, client):
        client.resume()
        client.pause()
        assert client.upload(MISSION).verified
        with pytest.raises(LinkError, match="a new mission was uploaded since; call start_mission"):
            client.resume()
        assert vehicle.custom_mode == BRAKE
        client.start_mission()  # in the air
        assert [m.param1 for m in vehicle.commands(mav.MAV_CMD_DO_SET_MISSION_CURRENT)] == [1.0]
        client.pause()
        client.resume()
        assert vehicle.custom_mode == AUTO


class FencedCopter(Copter):
    """One that has a fence, too, and refuses missions until it `takes_missions`."""

    def __init__(self):
        super().__init__()
        self.lists, self.kind, self.takes_missions = {0: (), 1: ()}, 0, False

    def __call__(self, vehicle, message):
        self.kind = getattr(message, "mission_type", self.kind)
        refusal = mav.MAVLink_mission_ack_message(245, 190, mav.MAV_MISSION_INVALID, 0)
        if message.get_type() == "MISSION_COUNT" and self.kind == 0 and not self.takes_missions:
            return [refusal]
        self.held = self.lists[self.kind]
        answers = super().__call__(vehicle, message)
        self.lists[self.kind] = self.held
        for answer in answers:
            if answer.get_type().startswith("MISSION"):
                answer.mission_type = self.kind
        return answers


def test_an_old_mission_is_not_flown_in_a_new_fence():
    """The fence is new and the mission refused: start and resume wait for another upload."""
    square = [(56.9, -4.1), (57.1, -4.1), (57.1, -3.9), (56.9, -3.9)]
    fenced = build_mission([(57.0, -4.0)], altitude_m=40.0, inclusions=[square])
    state = {"autopilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA, "status": mav.MAV_STATE_ACTIVE}
    answer = FencedCopter()
    with talking_to(answer, armed=True, custom_mode=BRAKE, **state) as (vehicle, client):
        client.resume()
        client.pause()
        result = client.upload(fenced)
        assert (result.verified, result.old_counts, result.fence_touched) == (False, True, True)
        for request in (client.start_mission, client.resume):
            with pytest.raises(LinkError, match="the fence is new and the mission old"):
                request()
        assert vehicle.custom_mode == BRAKE
        answer.takes_missions = True
        assert client.upload(fenced).verified
        client.start_mission()


def test_a_new_mission_that_somebody_else_has_started_may_be_resumed():
    with flying_copter() as (vehicle, client):
        assert client.upload(MISSION).verified
        vehicle.custom_mode = AUTO
        wait_for(lambda: client.vehicle.custom_mode == AUTO)
        vehicle.told.append(
            mav.MAVLink_global_position_int_message(0, 570_000_000, 0, 0, 0, 0, 0, 0, 65535)
        )
        wait_for(lambda: client.vehicle.latitude is not None)
        client.pause()
        client.resume()
        assert vehicle.custom_mode == AUTO


def test_a_mission_that_an_upload_left_as_it_was_may_be_resumed():
    with flying_copter(AUTO) as (vehicle, client):
        assert client.upload(MISSION).code is UploadCode.REFUSED_BEFORE
        client.pause()
        vehicle.answer.takes_items = False
        began = lambda: any(m.get_type() == "MISSION_COUNT" for m in vehicle.heard)  # noqa: E731

        def cancel():
            if not began():
                return False
            vehicle.answer.takes_items = True  # for the old one, which is put back
            return True

        result = client.upload(MISSION, should_cancel=cancel)
        assert (result.code, result.old_counts) == (UploadCode.CANCELLED, True), result
        client.resume()
        assert vehicle.custom_mode == AUTO
