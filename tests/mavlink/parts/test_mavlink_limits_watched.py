"""Limits in telemetry: the core by samples, and the driver with an autopilot that exceeds them."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from hypothesis import given
from hypothesis import strategies as st
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.limits import LONGEST, LimitWatch, Verdict
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_sim.autopilot.autopilot import Autopilot, Setpoint
from lfield_sim.autopilot.body.goals import Reach
from lfield_sim.autopilot.flavours import MavResult, SetpointControl

LIMIT, BOUND, TIME, STEP = 3.0, 3.6, 1.0, 0.1


def verdicts(values, *, still=0.0, step=STEP, excess=lambda value: value - BOUND):
    """The verdicts of a watch on samples at a fixed rate: (seconds, verdict)."""
    watch, found = LimitWatch(BOUND, TIME, still), []
    for n, value in enumerate(values):
        verdict = watch.sample(value, excess(value), n * step)
        if verdict is not None:
            found.append((round(n * step, 6), verdict))
        if verdict is Verdict.CORRECT:
            watch.on_correction_sent(n * step)
    return found


@given(st.lists(st.tuples(st.integers(1, 10), st.floats(3.61, 50.0)), max_size=30))
def test_excess_shorter_than_the_limit_time_is_no_breach(gusts):
    values = [value for samples, value in gusts for value in [*[value] * samples, 3.0]]
    assert verdicts(values) == []


@given(st.integers(0, 40), st.lists(st.floats(5.0, 50.0), min_size=40, max_size=40))
def test_lasting_excess_is_corrected_once_then_helpless(before, beyond):
    found = verdicts([*[2.0] * before, *beyond])
    corrected_at, first = found[0]
    assert first is Verdict.CORRECT
    assert corrected_at == pytest.approx(before * STEP + TIME, abs=1.01 * STEP)
    assert all(v is Verdict.FAILED and at >= corrected_at + TIME - 1e-6 for at, v in found[1:])


@given(st.floats(5.0, 30.0), st.floats(0.2, 0.45))
def test_effective_correction_gets_its_time(speed, share):
    """At any initial speed: the excess decreases by the same share each second."""
    after = [LIMIT + (speed - LIMIT) * share ** (n * STEP) for n in range(1, 100)]
    assert [verdict for _, verdict in verdicts([*[speed] * 11, *after])] == [
        Verdict.CORRECT,
        Verdict.WITHIN,
    ]


@given(st.floats(4.0, 12.0), st.integers(0, 5), st.floats(0.0, 3.0), st.floats(0.3, 5.0))
def test_slowing_vehicle_is_not_helpless(speed, late, gains, slows):
    """The vehicle may accelerate at first, and then slow down slowly."""
    top = speed + gains * late * STEP
    gaining = [speed + gains * n * STEP for n in range(1, late + 1)]
    slowing = [max(top - slows * n * STEP, 2.0) for n in range(1, 200)]
    found = verdicts([*[speed] * 11, *gaining, *slowing])
    given_up = [at for at, verdict in found if verdict is Verdict.FAILED]
    assert found[0] == (TIME, Verdict.CORRECT)
    if late * STEP + (top - BOUND) / slows < LONGEST * TIME - STEP:
        assert given_up == []
    assert all(at >= TIME + LONGEST * TIME - STEP for at in given_up)


@given(st.floats(4.0, 30.0), st.lists(st.floats(0.0, 0.05), min_size=60, max_size=60), st.integers(0, 30))
def test_vehicle_that_does_not_slow_down_in_time_is_helpless(speed, noise, sent_after):
    """The time starts when the correction was sent, or at its deadline."""
    watch, given_up = LimitWatch(BOUND, TIME), []
    for n, more in enumerate([0.0] * 11 + noise):
        if watch.sample(speed + more, speed + more - BOUND, n * STEP) is Verdict.FAILED:
            given_up.append(n * STEP)
        if n == 10 + sent_after:
            watch.on_correction_sent(n * STEP)
    assert given_up[0] == pytest.approx(TIME + min(sent_after * STEP, TIME) + TIME, abs=1.01 * STEP)


def test_vehicle_that_slows_down_too_long_is_helpless():
    found = verdicts([*[20.0] * 11, *(20.0 - 0.2 * n * STEP for n in range(1, 100))])
    assert found[:2] == [(TIME, Verdict.CORRECT), (TIME + LONGEST * TIME, Verdict.FAILED)]


def test_hold_beyond_the_radius_is_a_sufficient_correction():
    out = [5.0, *[5.0] * 10, *[max(5.0 - 0.25 * n, 0.0) for n in range(60)]]
    watch = LimitWatch(96.0, TIME, 0.5)
    found = [watch.sample(100.0, speed, n * STEP) for n, speed in enumerate(out)]
    assert [v for v in found if v] == [Verdict.CORRECT]
    # If it then moves further outwards, it is not.
    assert Verdict.FAILED in [watch.sample(101.0, 2.0, (len(out) + n) * STEP) for n in range(12)]


def test_gap_in_telemetry_is_no_excess():
    assert verdicts([9.0, 9.0, 9.0], step=TIME + 0.1) == []
    watch = LimitWatch(BOUND, TIME)
    watch.sample(9.0, 5.4, 0.0)
    watch.reset()
    assert watch.sample(9.0, 5.4, TIME) is None


# -- the driver ---------------------------------------------------------------------------------------

OPTIONS = {"limit_tolerance": 0.2, "limit_time": 1.0}


@pytest.fixture
def limited(bench):
    return lambda **given: bench(options=OPTIONS, **given)


async def fastest(b, work):
    """The highest speed over ground during `work`."""
    flight, most = asyncio.create_task(work), 0.0
    while not flight.done():
        await asyncio.sleep(0.05)
        most = max(most, math.hypot(*b.autopilot.vehicle.velocity[:2]))
    await flight
    return most


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["copter", "rover"])
@on_bench("limited", limits={"speed": 3.0}, given="kind")
async def test_ardupilot_flies_the_commanded_speed_in_every_motion(b, fc, /, kind):
    await fc.execute("arm", [])
    if kind == "copter":
        await fc.execute("takeoff", [5.0])
    # A speed may be set before any motion.
    await fc.execute("setSpeed", [2.0])
    assert await fastest(b, fc.execute("goTo", [15.0, 0.0, -5.0])) <= 2.05
    await fc.execute("setSpeed", [3.0])
    # A rover approaches its speed from below: a real one overshoots by 15 %.
    least = 2.9 if kind == "copter" else 2.4
    assert least < await fastest(b, fc.execute("goTo", [30.0, 0.0, -5.0])) <= 3.07
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    await asyncio.sleep(0.3)
    latitude, longitude, _ = b.values["globalPosition"]
    assert await fastest(b, fc.execute("goToGlobal", [latitude - 1e-4, longitude, 5.0])) <= 3.07
    await fc.execute("hold", [])
    assert await fastest(b, fc.execute("goTo", [15.0, 0.0, -5.0])) <= 3.07
    assert await fastest(b, fc.execute("orbit", [15.0, 0.0, -5.0, 4.0, 2.0, 0.3])) <= 2.25
    assert [note for note in b.notes if "limit exceeded" in note] == []


@pytest.mark.few(0)
@on_bench("limited", flavour="px4", kind="rover", limits={"speed": 2.0})
async def test_px4_rover_overspeed_is_compensated(b, fc, /):
    await fc.execute("arm", [])
    assert 1.8 < await fastest(b, fc.execute("goTo", [25.0, 0.0, 0.0])) <= 2.1
    await asyncio.sleep(3.0)  # it coasts
    await fc.execute("setSpeed", [0.6])
    assert 0.6 < await fastest(b, fc.execute("goTo", [32.0, 0.0, 0.0])) <= 0.8
    assert [note for note in b.notes if "limit exceeded" in note] == []


@on_bench("limited", limits={"speed": 3.0})
async def test_changed_speed_is_reported_and_commanded_again(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, -5.0]))
    await asyncio.sleep(3.0)
    b.autopilot.speed_control.change(7.0)  # by another ground station
    await asyncio.sleep(12.0)
    assert b.values["groundSpeed"] == pytest.approx(3.0, abs=0.1)
    await flight
    assert b.notes.count("speed of 3 m/s commanded again") == 1
    assert [note.split(", ", 1)[1] for note in b.notes if "beyond" in note] == [
        "beyond its limit of 3 m/s; commanded to be slower"
    ]
    assert "within its limit of 3 m/s again" in b.notes
    assert b.breaches == []


@pytest.mark.few(0)
def test_repeated_overspeed_stays_corrected_for_the_motion(limited, monkeypatch):
    b, set_speed = limited(limits={"speed": 3.0}), Autopilot.set_speed
    monkeypatch.setattr(Autopilot, "set_speed", lambda self, speed: set_speed(self, 1.5 * speed))

    async def mission(fc):
        await up(fc)
        for goal in (70.0, 0.0):
            await fc.execute("goTo", [goal, 0.0, -5.0])

    b.run(mission)
    reports = [note.split("; ")[-1] for note in b.notes if "beyond" in note or "again" in note]
    motion = [
        "commanded to be slower", "within its limit of 3 m/s again", "speed of 3 m/s commanded again",
        "commanded to be slower for the rest of this motion", "within its limit of 3 m/s again",
    ]  # fmt: skip
    assert reports == motion * 2
    assert b.breaches == []


def test_overspeed_without_effective_correction_is_a_breach(limited, monkeypatch):
    b = limited(limits={"speed": 3.0})
    monkeypatch.setattr(Autopilot, "set_speed", lambda self, speed: MavResult.ACCEPTED)

    async def mission(fc):
        await up(fc)
        b.autopilot.speed_control.own_speed = lambda: 7.0
        flight = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, -5.0]))
        await asyncio.sleep(6.0)
        flight.cancel()

    b.run(mission)
    assert b.breaches[0].endswith("beyond its limit of 3 m/s, and corrections had no effect")


@on_bench("limited", limits={"speed": 3.0})
async def test_lost_correction_is_repeated_without_a_breach(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, -5.0]))
    await asyncio.sleep(3.0)
    send, lost = b.links[0].send, []

    def lose_two(data):
        (message,) = Reader().feed(data)
        command = getattr(message, "command", 0)
        if command == dialect.MAV_CMD_DO_CHANGE_SPEED and len(lost) < 2:
            lost.append(command)
        else:
            send(data)

    b.links[0].send = lose_two
    b.autopilot.speed_control.change(7.0)
    await flight
    assert len(lost) == 2
    assert "within its limit of 3 m/s again" in b.notes
    assert b.breaches == []


def test_excess_of_the_radius_holds_and_ends_the_motion(limited, monkeypatch):
    b, guide = limited(limits={"radius": 20.0}), Autopilot.guide

    async def mission(fc):
        await up(fc)
        astray = Setpoint(Reach((60.0, 0.0, -5.0)), control=SetpointControl.PLACE)
        monkeypatch.setattr(Autopilot, "guide", lambda self, _: guide(self, astray))
        # The target reports are dropped: otherwise the driver would report a takeover.
        target = dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT
        b.filter = lambda link, packet: (
            None if any(m.get_msgId() == target for m in Reader().feed(packet)) else link.on_data(packet)
        )
        flight = asyncio.create_task(fc.execute("goTo", [0.0, 15.0, -5.0]))
        with pytest.raises(DeviceError, match=r"goTo was stopped: .* m from home, beyond its limit"):
            await flight
        await asyncio.sleep(5.0)

    b.run(mission)
    # It has stopped and hovers.
    assert b.autopilot.mode == "GUIDED"
    assert math.hypot(*b.autopilot.vehicle.velocity) < 0.1
    assert b.breaches == []


@on_bench("limited", limits={"speed": 3.0})
async def test_excess_under_pilot_control_is_only_reported(b, fc, /):
    await up(fc)
    b.autopilot.enter("RTL")
    b.autopilot.parameters["RTL_ALT"] = 500
    b.autopilot.vehicle.place = (90.0, 0.0, -5.0)
    b.autopilot.speed_control.change(7.0)
    await asyncio.sleep(8.0)
    (report,) = [note for note in b.notes if note.code == "mavlink-limit-exempt"]
    assert report.endswith("since a pilot or a failsafe controls it in RTL")
    assert b.breaches == []


@on_bench("limited", flavour="px4", limits={"speed": 3.0})
async def test_px4_hold_targets_the_stopping_position(b, fc, /):
    """In OFFBOARD, which PX4 leaves by itself when setpoints stop."""
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, -5.0]))
    await asyncio.sleep(5.0)
    sent = len(b.sent)
    flight.cancel()
    await fc.execute("hold", [])
    await asyncio.sleep(5.0)
    assert math.hypot(*b.autopilot.vehicle.velocity) < 0.1
    places = {
        (round(m.x, 2), round(m.y, 2)) for data in b.sent[sent:] for m in Reader().feed(data)
        if m.get_msgId() == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
    }  # fmt: skip
    assert len(places) == 1
    assert places.pop() == pytest.approx(b.autopilot.vehicle.place[:2], abs=0.5)
    assert b.autopilot.mode == "OFFBOARD"
