"""Faults of the fakes, event by event, against recordings of a real ArduCopter (gauntlet-a and -b)."""

from __future__ import annotations

import math

import pytest
from recorded_flight import events

from lfield_mavlink.link.dialect import dialect
from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.mavlink.link.radio_link import make_faults
from lfield_sim.mavlink.mavlink_fake import STEP, MavlinkFake

GUIDED, LAND = 4, 9
#: Texts about actions of the recorder, or about the number of estimator cores.
OTHERS = ("Mode change", "EKF3", "EKF primary", "SIM Hit", "Disarming", "PreArm", "Glitch cleared")
#: Seconds by which a heartbeat or text may be early or late: they are sent at 5 Hz or less.
NEAR = 0.6


def condensed(messages):
    """Changes of mode and system status, and texts: seconds and text."""
    found, last = [], None
    for at, message in messages:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            state = message.custom_mode, message.system_status
            if last is not None and state != last:
                found.append((at, f"mode {state[0]}, status {state[1]}"))
            last = state
        elif kind == "STATUSTEXT":
            text = message.text.decode() if isinstance(message.text, bytes) else message.text
            if not text.startswith(OTHERS):
                # Voltages and charges differ by battery.
                found.append((at, text.rstrip("\0").split(" 10.00V")[0]))
    return found


def recorded(name, note, seconds):
    """The events from the note of a fault on."""
    started, messages = None, []
    for event in events(name):
        if note in event.note and started is None:
            started = event.at
        if started is not None and event.at > started + seconds:
            break
        if started is not None and event.message is not None:
            messages.append((event.at - started, event.message))
    return condensed(messages)


class Flight:
    """A simulated ArduCopter, 8 m up and flying to a goal."""

    def __init__(self, **parameters: float) -> None:
        faults = make_faults()
        self.autopilot = Autopilot(FLAVOURS["ardupilot"]["copter"])
        self.fake = MavlinkFake(self.autopilot, faults=faults)
        self.autopilot.parameters |= parameters
        self.autopilot.apply_parameters()
        self.fault = lambda *texts: faults.apply(texts)
        self._out, self._back = dialect.MAVLink(None, srcSystem=255, srcComponent=190), dialect.MAVLink(None)
        self.received: list = []
        self.command(dialect.MAV_CMD_DO_SET_MODE, 1, GUIDED)
        self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.command(dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 8)
        self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 200_000)
        self.wait(14.0)
        self.goes(60.0)
        self.wait(4.0)

    def send(self, message):
        answers = self.fake.receive("c", message.pack(self._out))
        return self._back.parse_buffer(b"".join(answers)) or []

    def command(self, number, *values):
        padded = [*values, *[0.0] * (7 - len(values))]
        answers = self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *padded))
        return next((each.result for each in answers if each.get_type() == "COMMAND_ACK"), None)

    def goes(self, north):
        fields = (north, 0.0, -8.0, *[0.0] * 8)
        self.send(dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x0DF8, *fields))

    def wait(self, seconds):
        for _ in range(round(seconds / STEP)):
            packets = self.fake.advance(STEP)
            now = self.autopilot.now
            self.received += [(now, m) for m in self._back.parse_buffer(b"".join(packets)) or []]

    def events_since(self, began):
        changes = condensed([(at - began, message) for at, message in self.received])
        return [(at, text) for at, text in changes if at >= 0.0]


def recorded_heights(name, note, seconds):
    """Seconds and height in metres, from the note of a fault on."""
    heights, started = [], None
    for event in events(name):
        if note in event.note and started is None:
            started = event.at
        if started is not None and event.at > started + seconds:
            break
        place = event.message is not None and event.message.get_type() == "LOCAL_POSITION_NED"
        if started is not None and place:
            heights.append((event.at - started, -event.message.z))
    return heights


def assert_falls_alike(flight, heights, apart):
    """Assert that the fake falls like the real vehicle at each time from now on."""
    started, top = flight.autopilot.now, -flight.autopilot.vehicle.place[2]
    for at, height in heights:
        flight.wait(started + at - flight.autopilot.now)
        lost, lost_really = top + flight.autopilot.vehicle.place[2], heights[0][1] - height
        assert abs(lost - lost_really) < apart, f"{lost:.1f} m after {at:.1f} s, really {lost_really:.1f} m"


def assert_alike(real, fake):
    assert [text for _, text in fake] == [text for _, text in real]
    for (at, text), (was, _) in zip(fake, real, strict=True):
        assert abs(at - was) <= NEAR, f"{text}: after {at:.1f} s, really {was:.1f} s"


def test_gps_loss_leads_to_the_ekf_failsafe_as_recorded():
    real = recorded("ap-copter.gauntlet-a", "GPS off for 25 s: begins", 9.0)
    flight = Flight()
    started = flight.autopilot.now
    flight.fault("gps_loss=true")
    flight.wait(9.0)
    assert any("EKF Failsafe: changed to LAND Mode" in text for _, text in real)
    assert_alike(real, flight.events_since(started))
    assert flight.command(dialect.MAV_CMD_DO_SET_MODE, 1, GUIDED) != dialect.MAV_RESULT_ACCEPTED


def test_battery_failsafe_acts_once_and_guided_ends_it_as_recorded():
    """The real failsafe acts by voltage after 10 s (BATT_LOW_TIMER), the fake's by charge."""
    real = recorded("ap-copter.gauntlet-a", "battery low (10 V), BATT_FS_LOW_ACT 1 land: begins", 48.0)
    acts = next(at for at, text in real if text.startswith("mode"))
    back = next(at for at, text in real if text.startswith(f"mode {GUIDED},") and at > acts)
    flight = Flight(BATT_FS_LOW_ACT=1, BATT_LOW_MAH=660)
    flight.fault("battery=0.19")
    started = flight.autopilot.now
    flight.wait(back - acts)
    assert flight.command(dialect.MAV_CMD_DO_SET_MODE, 1, GUIDED) == dialect.MAV_RESULT_ACCEPTED
    flight.goes(60.0)
    flight.wait(20.0)
    fake = [
        (at, text.split(" 1")[0] if "is low" in text else text) for at, text in flight.events_since(started)
    ]
    real = [(at - acts, text.split(" 1")[0] if "is low" in text else text) for at, text in real]
    assert sorted(text for _, text in fake) == sorted(text for _, text in real)
    assert flight.autopilot.mode == "GUIDED"
    assert flight.command(dialect.MAV_CMD_DO_SET_MODE, 1, LAND) == dialect.MAV_RESULT_ACCEPTED
    flight.wait(25.0)
    assert not flight.autopilot.armed
    flight.command(dialect.MAV_CMD_DO_SET_MODE, 1, GUIDED)
    assert flight.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1) == dialect.MAV_RESULT_FAILED
    flight.wait(0.1)
    assert "Arm: Battery failsafe" in [text for _, text in flight.events_since(started)]


def test_weak_motor_falls_as_recorded():
    """Compares the heights from the fault to the ground."""
    heights = recorded_heights("ap-copter.gauntlet-b", "set SIM_ENGINE_FAIL = 1", 4.1)
    flight = Flight()
    started = flight.autopilot.now
    flight.fault("motor_power=0.6")
    assert_falls_alike(flight, heights, 1.2)
    texts = [text for _, text in recorded("ap-copter.gauntlet-b", "set SIM_ENGINE_FAIL = 1", 4.0)]
    assert [text for _, text in flight.events_since(started)] == texts


@pytest.mark.parametrize(("name", "note", "fault"), [
    ("ap-copter.gauntlet-a", "all compasses fail for 25 s: begins", "compass_failure=true"),
    ("ap-copter.gauntlet-b", "GPS glitch", "gps_glitch=33"),
])  # fmt: skip
def test_flight_continues_with_gps_glitch_or_without_compasses(name, note, fault):
    real = recorded(name, note, 7.0)
    flight = Flight()
    started = flight.autopilot.now
    flight.fault(fault)
    flight.wait(7.0)
    assert_alike(real, flight.events_since(started))
    assert flight.autopilot.mode == "GUIDED"


def test_forced_disarm_in_flight_falls_and_can_rearm_as_recorded():
    heights = recorded_heights("ap-copter.gauntlet-b", "forced disarm by a second station", 1.4)
    flight = Flight()
    assert flight.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == dialect.MAV_RESULT_ACCEPTED
    # The first height after the note is the start of the fall.
    assert_falls_alike(flight, [(at - heights[0][0], height) for at, height in heights], 0.6)
    flight.wait(0.3)
    assert flight.autopilot.vehicle.place[2] == pytest.approx(0.0, abs=0.3)
    assert flight.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1) == dialect.MAV_RESULT_ACCEPTED


def test_goal_of_another_station_is_flown_without_mode_or_text():
    """The packet of the recording: a goal at (-20, -20), 8 m up, from system 77."""
    goal, started, real, places = (-20.0, -20.0), None, [], []
    for event in events("ap-copter.gauntlet-a"):
        if "second station: GUIDED and a goal of its own" in event.note:
            started = event.at
        if started is None or event.message is None or event.at > started + 10.0:
            continue
        real.append((event.at - started, event.message))
        if event.message.get_type() == "LOCAL_POSITION_NED":
            places.append((event.message.x, event.message.y))
    assert condensed(real) == []
    assert math.dist(places[-1], goal) < math.dist(places[0], goal) - 10.0
    flight = Flight()
    started, place = flight.autopilot.now, flight.autopilot.vehicle.place[:2]
    other = dialect.MAVLink(None, srcSystem=77, srcComponent=190)
    fields = dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 3576, *goal, -8.0, *[0.0] * 8)
    flight.fake.receive("other", fields.pack(other))
    flight.wait(10.0)
    assert flight.events_since(started) == []
    assert math.dist(flight.autopilot.vehicle.place[:2], goal) < math.dist(place, goal) - 5.0
