"""A link that loses packets both ways: what has a time-to-live is done by what tells first."""

from __future__ import annotations

import asyncio

import pytest

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect

CALLS, TTL = 200, 0.5
TOLD = (dialect.MAVLINK_MSG_ID_CURRENT_MODE, dialect.MAVLINK_MSG_ID_HEARTBEAT)


@pytest.fixture
def flown(bench):
    """A PX4 that hovers, and what is done to it then."""

    def run(work):
        b = bench(flavour="px4", ttl=TTL)

        async def mission(fc):
            await fc.execute("arm", [])
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


def test_the_first_velocity_is_in_time_however_bad_the_link_is(flown):
    """CURRENT_MODE comes once, and then not for half a second: too late when that packet is lost."""

    async def work(b, fc):
        loop, took = asyncio.get_running_loop(), []
        b.faults.apply(["loss=0.2"])
        for number in range(CALLS):
            await fc.execute("hold", [])
            await asyncio.sleep(0.2 + 0.013 * (number % 10))
            start = loop.time()
            await fc.execute("setVelocity", [0.2 * (-1.0) ** number, 0.0, 0.0])
            took.append(loop.time() - start)
            assert b.autopilot.mode == "OFFBOARD"
        return took

    took = flown(work)
    assert max(took) < TTL
    assert sum(seconds > 0.35 for seconds in took) < 0.05 * CALLS


def test_what_it_accepts_and_does_not_speak_against_is_believed_while_it_shows_no_mode(flown):
    async def work(b, fc):
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
        fc.motion.stream.start = lambda message, until: None
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
