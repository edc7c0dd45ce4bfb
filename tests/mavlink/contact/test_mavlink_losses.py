"""A link that loses packets both ways: calls with a time-to-live end with the first confirmation."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import scenario

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_sim.autopilot.flavours import MavResult

CALLS, TTL, SEEDS = 100, 0.5, 20
VEHICLES = [("ardupilot", "copter"), ("ardupilot", "rover"), ("px4", "copter")]
SHOWS_MODE = (dialect.MAVLINK_MSG_ID_CURRENT_MODE, dialect.MAVLINK_MSG_ID_HEARTBEAT)


@pytest.fixture
def flown(bench):
    """Runs `work` with a vehicle under way, by default a PX4."""

    def run(work, *, flavour="px4", kind="copter", **given):
        b = bench(flavour=flavour, kind=kind, ttl=TTL, **given)

        async def mission(fc):
            await fc.execute("arm", [])
            if kind == "copter":
                await fc.execute("takeoff", [5.0])
            return await work(b, fc)

        return b.run(mission)

    return run


def without(*kinds):
    """Delivers all messages of the vehicle except these kinds."""
    reader = Reader()

    def passes(link, packet):
        if not any(message.get_msgId() in kinds for message in reader.feed(packet)):
            link.on_data(packet)

    return passes


@pytest.mark.few(0)
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
def test_first_velocity_meets_its_ttl_on_a_link_with_losses(flown, flavour, kind):
    """The mode is reported once and then late: the report may miss the TTL if that packet is lost."""

    async def work(b, fc):
        loop, took, guided = asyncio.get_running_loop(), [], fc.profile.guided
        b.faults.apply(["loss=0.2"])
        for number in range(CALLS):
            await fc.execute("setMode", [fc.profile.hold])
            assert b.autopilot.mode == fc.profile.hold
            await asyncio.sleep(0.2 + 0.013 * (number % 10))
            start = loop.time()
            await fc.execute("setVelocity", [0.2 * (-1.0) ** number, 0.0, 0.0])
            took.append(loop.time() - start)
            assert b.autopilot.mode == guided
        return took

    took = flown(work, flavour=flavour, kind=kind)
    assert max(took) < TTL
    assert sum(seconds > 0.35 for seconds in took) < 0.05 * CALLS


@pytest.mark.few(1)
@pytest.mark.parametrize("pause", [0.1, 0.2])
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
@pytest.mark.parametrize("seed", range(1, SEEDS + 1))
def test_alternating_velocities_and_holds_meet_the_ttl_with_losses(flown, flavour, kind, seed, pause):
    """The system id seeds the losses. Each hold is carried out, however soon after a velocity."""

    async def work(b, fc):
        loop = asyncio.get_running_loop()
        b.faults.apply(["loss=0.2"])
        for number in range(8):
            for _ in range(8):
                start = loop.time()
                await fc.execute("setVelocity", [1.5 * (-1.0) ** number, 0.0, 0.0])
                assert loop.time() - start < TTL
                await asyncio.sleep(pause)
            await fc.execute("setMode", [fc.profile.hold])
            assert b.autopilot.mode == fc.profile.hold

    flown(work, flavour=flavour, kind=kind, systems=(seed,), limits={"speed": 3.0})


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(1, SEEDS + 1))
@pytest.mark.parametrize("kind", ["copter", "rover"])
def test_late_mode_acknowledgement_does_not_confirm_a_hold(flown, kind, seed):
    """GUIDED is requested several times meanwhile, and the hold is lost."""

    async def work(b, fc):
        b.faults.apply(["loss=0.2", "delay=0.15"])
        for _ in range(20):
            await fc.execute("setVelocity", [0.5, 0.0, 0.0])
            assert b.autopilot.mode == "GUIDED"
            await fc.execute("hold", [])
            assert b.autopilot.mode == fc.profile.hold

    flown(work, flavour="ardupilot", kind=kind, systems=(seed,))


@scenario("flown", flavour="ardupilot")
async def test_refused_guided_mode_is_reported_with_its_result(b, fc, /, monkeypatch):
    await fc.execute("hold", [])
    monkeypatch.setattr(type(b.autopilot), "set_mode", lambda *_: MavResult.FAILED)
    with pytest.raises(DeviceError, match="GUIDED refused: FAILED"):
        await fc.execute("setVelocity", [0.5, 0.0, 0.0])


@scenario("flown")
async def test_accepted_offboard_without_mode_report_is_believed(b, fc, /):
    await fc.execute("setMode", ["AUTO.LOITER"])
    b.filter = without(*SHOWS_MODE)
    loop = asyncio.get_running_loop()
    for _ in range(3):
        start = loop.time()
        await fc.execute("setVelocity", [0.5, 0.0, 0.0])
        assert 0.2 < loop.time() - start < 0.35
    assert b.autopilot.mode == "OFFBOARD"
    # The driver is still in control, although the last reported mode differs.
    await fc.execute("setVelocity", [0.0, 0.0, 0.0])
    assert b.values["mode"] != "OFFBOARD"


@scenario("flown")
async def test_offboard_rejected_by_status_text_is_refused(b, fc, /):
    """The first status text is lost."""
    await fc.execute("setMode", ["AUTO.LOITER"])
    await asyncio.sleep(2.0)
    fc.motion.stream.start = lambda target, until: None
    are_texts = []

    def lose_the_first(link, packet):
        (message,) = Reader().feed(packet)
        are_texts.append(message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT)
        if not are_texts[-1] or sum(are_texts) > 1:
            link.on_data(packet)

    b.filter = lose_the_first
    with pytest.raises(DeviceError, match="OFFBOARD was refused"):
        await fc.execute("setVelocity", [0.5, 0.0, 0.0])
    assert sum(are_texts) >= 3


def losing(b, *kinds):
    """Drops messages of these kinds to the vehicle; the returned set may be changed."""
    link, lost = b.links[0], set(kinds)
    send = link.send
    reader = Reader()

    def passes(data):
        if not any(message.get_msgId() in lost for message in reader.feed(data)):
            send(data)

    link.send = passes
    return lost


COMMANDS = (dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_COMMAND_INT)
SETPOINT = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


@scenario("flown")
async def test_setpoints_continue_until_a_hold_in_unconfirmed_offboard(b, fc, /):
    """A vehicle that only accepted OFFBOARD needs setpoints as one that reported it."""
    await fc.execute("setMode", ["AUTO.LOITER"])
    b.filter = without(*SHOWS_MODE)
    await fc.execute("setVelocity", [0.5, 0.0, 0.0])
    lost = losing(b, *COMMANDS)
    asyncio.get_running_loop().call_later(2.2, lost.clear)
    holding = asyncio.ensure_future(fc.execute("setMode", ["AUTO.LOITER"]))
    await asyncio.sleep(2.0)
    assert b.autopilot.mode == "OFFBOARD"
    await holding
    assert b.autopilot.mode == "AUTO.LOITER"
    b.sent.clear()
    await asyncio.sleep(1.0)
    kinds = [message.get_msgId() for data in b.sent for message in Reader().feed(data)]
    assert SETPOINT not in kinds


@pytest.mark.few(1)
@pytest.mark.parametrize("shown", [False, True])
@pytest.mark.parametrize("late", [0.0, 0.6])
@scenario("flown")
async def test_failsafe_before_a_hold_does_not_block_later_velocities(b, fc, /, late, shown):
    """Setpoints and the command were lost until PX4's failsafe; its text may arrive after the mode."""
    await fc.execute("setMode", ["AUTO.LOITER"])
    if not shown:
        b.filter = without(*SHOWS_MODE)
    await fc.execute("setVelocity", [0.5, 0.0, 0.0])
    loop, reader = asyncio.get_running_loop(), Reader()

    def passes(link, packet):
        (message,) = reader.feed(packet)
        text = message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT
        loop.call_later(late if text else 0.0, link.on_data, packet)

    b.filter = passes
    lost = losing(b, *COMMANDS, SETPOINT)
    await asyncio.sleep(0.4)
    holding = asyncio.ensure_future(fc.execute("setMode", ["AUTO.LOITER"]))
    await b.until(lambda: b.autopilot.mode != "OFFBOARD")
    lost.clear()
    await holding
    await asyncio.sleep(0.2)
    for _ in range(12):
        await fc.execute("setVelocity", [0.5, 0.0, 0.0])
        await asyncio.sleep(0.2)
    assert not fc.taken_over()


@scenario("flown")
async def test_failsafe_right_after_a_hold_takes_control(b, fc, /):
    """The failsafe text arrives when late texts are expected; the heartbeat shows an active failsafe."""
    await fc.execute("setVelocity", [0.5, 0.0, 0.0])
    await fc.execute("setMode", ["AUTO.LOITER"])
    await asyncio.sleep(0.3)
    b.autopilot.critical = True
    b.autopilot.say("Failsafe activated\t")
    await asyncio.sleep(3.0)
    assert fc.taken_over()
