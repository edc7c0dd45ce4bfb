"""A link that loses packets both ways: what has a time-to-live is done by what tells first."""

from __future__ import annotations

import asyncio

import pytest

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_sim.autopilot.flavours import MavResult

CALLS, TTL, SEEDS = 100, 0.5, 20
VEHICLES = [("ardupilot", "copter"), ("ardupilot", "rover"), ("px4", "copter")]
TOLD = (dialect.MAVLINK_MSG_ID_CURRENT_MODE, dialect.MAVLINK_MSG_ID_HEARTBEAT)


@pytest.fixture
def flown(bench):
    """A vehicle that is under way, a PX4 unless a test wants another, and what is done to it then."""

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
    """What the vehicle says, but for some messages."""
    reader = Reader()

    def passes(link, packet):
        if not any(message.get_msgId() in kinds for message in reader.feed(packet)):
            link.on_data(packet)

    return passes


@pytest.mark.few(1)
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
def test_the_first_velocity_is_in_time_however_bad_the_link_is(flown, flavour, kind):
    """What shows the mode comes once, and then not for a while: too late when that packet is lost."""

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


@pytest.mark.few(2)
@pytest.mark.parametrize("pause", [0.1, 0.2])
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
@pytest.mark.parametrize("seed", range(1, SEEDS + 1))
def test_velocities_and_holds_by_turns_are_in_time_on_a_bad_link(flown, flavour, kind, seed, pause):
    """The dice of a link are those of the system's id. Each hold is one, however soon after a velocity."""

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


@pytest.mark.few(3)
@pytest.mark.parametrize("seed", range(1, SEEDS + 1))
@pytest.mark.parametrize("kind", ["copter", "rover"])
def test_a_late_acknowledgement_of_an_entry_is_none_of_a_hold(flown, kind, seed):
    """The entry is asked for several times meanwhile, and what is lost is the hold."""

    async def work(b, fc):
        b.faults.apply(["loss=0.2", "delay=0.15"])
        for _ in range(20):
            await fc.execute("setVelocity", [0.5, 0.0, 0.0])
            assert b.autopilot.mode == "GUIDED"
            await fc.execute("hold", [])
            assert b.autopilot.mode == fc.profile.hold

    flown(work, flavour="ardupilot", kind=kind, systems=(seed,))


def test_an_entry_that_is_refused_is_told_in_its_words(flown, monkeypatch):
    async def work(b, fc):
        await fc.execute("hold", [])
        monkeypatch.setattr(type(b.autopilot), "set_mode", lambda *_: MavResult.FAILED)
        with pytest.raises(DeviceError, match="GUIDED refused: FAILED"):
            await fc.execute("setVelocity", [0.5, 0.0, 0.0])

    flown(work, flavour="ardupilot")


def test_what_it_accepts_and_does_not_speak_against_is_believed_while_it_shows_no_mode(flown):
    async def work(b, fc):
        await fc.execute("setMode", ["AUTO.LOITER"])
        b.filter = without(*TOLD)
        loop = asyncio.get_running_loop()
        for _ in range(3):
            start = loop.time()
            await fc.execute("setVelocity", [0.5, 0.0, 0.0])
            assert 0.2 < loop.time() - start < 0.35
        assert b.autopilot.mode == "OFFBOARD"
        # It is still ours, whatever its last mode was.
        await fc.execute("setVelocity", [0.0, 0.0, 0.0])
        assert b.values["mode"] != "OFFBOARD"

    flown(work)


def test_what_it_speaks_against_is_not_believed(flown):
    """Its words are lost the first time."""

    async def work(b, fc):
        await fc.execute("setMode", ["AUTO.LOITER"])
        await asyncio.sleep(2.0)
        fc.motion.stream.start = lambda target, until: None
        said = []

        def lose_the_first(link, packet):
            (message,) = Reader().feed(packet)
            said.append(message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT)
            if not said[-1] or sum(said) > 1:
                link.on_data(packet)

        b.filter = lose_the_first
        with pytest.raises(DeviceError, match="OFFBOARD was refused"):
            await fc.execute("setVelocity", [0.5, 0.0, 0.0])
        assert sum(said) >= 3

    flown(work)


def losing(b, *kinds):
    """Nothing of these kinds gets to the vehicle; what is lost can be changed."""
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


def test_setpoints_go_on_until_a_hold_arrives_where_offboard_was_believed(flown):
    """What only accepted OFFBOARD waits for setpoints as one that has shown it does."""

    async def work(b, fc):
        await fc.execute("setMode", ["AUTO.LOITER"])
        b.filter = without(*TOLD)
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

    flown(work)


@pytest.mark.few(1)
@pytest.mark.parametrize("shown", [False, True])
@pytest.mark.parametrize("late", [0.0, 0.6])
def test_a_failsafe_that_came_before_a_hold_is_none_after_it(flown, late, shown):
    """Setpoints and the command were lost for so long that PX4 acted; its text may come after the mode."""

    async def work(b, fc):
        await fc.execute("setMode", ["AUTO.LOITER"])
        if not shown:
            b.filter = without(*TOLD)
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

    flown(work)


def test_a_failsafe_right_after_a_hold_has_it(flown):
    """Its text comes within the time of late ones; that it lasts shows by the heartbeat."""

    async def work(b, fc):
        await fc.execute("setVelocity", [0.5, 0.0, 0.0])
        await fc.execute("setMode", ["AUTO.LOITER"])
        await asyncio.sleep(0.3)
        b.autopilot.critical = True
        b.autopilot.say("Failsafe activated\t")
        await asyncio.sleep(3.0)
        assert fc.taken_over()

    flown(work)
