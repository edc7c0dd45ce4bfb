"""The send queue of a connection: order, deadlines and cancelled senders, on a clock of the test."""

from __future__ import annotations

import asyncio
import threading
from contextlib import asynccontextmanager

import can
import pytest

from lfield.errors import DeviceError
from lfield_can.bus import connection
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.connection import BACKLOG, POST_TIMEOUT, SEND_TIMEOUT, Connection
from lfield_can.bus.endpoint import parse_endpoint
from lfield_can.bus.frames import BUS_LOST, Frame, Listener

#: Seconds after which a thread without progress is a fault.
BOUND = 60.0
TOO_LATE = "it was queued for too long"
FULL = "Transmit buffer full"
PLACE = parse_endpoint("virtual:queue")
LISTENER = Listener(lambda frame: None, lambda identifier, data: None, lambda reason: None)


class Interface(can.BusABC):
    """An interface whose buffer is full, or whose `send` blocks, while the test requires it."""

    def __init__(self) -> None:
        super().__init__(channel="queue")
        self.now = 0.0
        #: Seconds that a refused frame takes.
        self.passes = 0.0
        self.full = False
        self.sent: list[int] = []
        self.entered, self.refused = threading.Event(), threading.Event()
        self.open = threading.Event()
        self.open.set()
        self._ended = threading.Event()

    def _recv_internal(self, timeout):
        self._ended.wait(timeout)
        return None, True

    def send(self, msg, timeout=None):
        self.entered.set()
        assert self.open.wait(BOUND)
        if self.full:
            self.now += self.passes
            self.refused.set()
            raise can.CanOperationError(FULL)
        self.sent.append(msg.arbitration_id)

    def shutdown(self):
        super().shutdown()
        self._ended.set()
        self.open.set()


@pytest.fixture
def interface(monkeypatch):
    made = Interface()
    monkeypatch.setattr(connection.can, "Bus", lambda **_: made)
    yield made
    made.shutdown()


@asynccontextmanager
async def connected(interface):
    """A connection on the clock of its interface."""
    made = Connection(PLACE, LISTENER, asyncio.get_running_loop(), lambda: interface.now)
    try:
        yield made
    finally:
        interface.open.set()
        await made.close()


def sending(link, number):
    """The task of a sender."""
    return asyncio.create_task(link.send(Frame(number)))


async def occupied(link, interface):
    """The writer thread is blocked in `send` of frame 1; later frames are queued behind it."""
    interface.open.clear()
    first = sending(link, 1)
    assert await asyncio.to_thread(interface.entered.wait, BOUND)
    return first


async def result(task):
    async with asyncio.timeout(BOUND):
        return await task


async def test_late_posted_frame_is_dropped_and_one_with_a_sender_is_not(interface):
    async with connected(interface) as link:
        first = await occupied(link, interface)
        link.post(Frame(2))
        third = sending(link, 3)
        await asyncio.sleep(0)
        interface.now = POST_TIMEOUT + 0.001
        link.post(Frame(4))
        interface.open.set()
        assert (await result(first), await result(third)) == ("", "")
        assert await result(sending(link, 5)) == ""
    assert interface.sent == [1, 3, 4, 5]


async def test_frame_with_a_sender_is_dropped_after_its_own_deadline(interface):
    async with connected(interface) as link:
        first = await occupied(link, interface)
        second = sending(link, 2)
        await asyncio.sleep(0)
        interface.now = SEND_TIMEOUT + 0.001
        third = sending(link, 3)
        await asyncio.sleep(0)
        interface.open.set()
        assert [await result(task) for task in (first, second, third)] == ["", TOO_LATE, ""]
    assert interface.sent == [1, 3]


async def test_stop_is_sent_right_after_an_earlier_valid_setpoint(interface):
    async with connected(interface) as link:
        interface.full = True
        setpoint = sending(link, 1)
        assert await asyncio.to_thread(interface.refused.wait, BOUND)
        interface.now = SEND_TIMEOUT / 2
        stop = sending(link, 2)
        await asyncio.sleep(0)
        interface.full = False
        assert (await result(setpoint), await result(stop)) == ("", "")
    assert interface.sent == [1, 2]


async def test_stop_does_not_share_the_deadline_of_an_earlier_setpoint(interface):
    async with connected(interface) as link:
        interface.full = True
        setpoint = sending(link, 1)
        assert await asyncio.to_thread(interface.refused.wait, BOUND)
        interface.now = SEND_TIMEOUT / 2
        stop = sending(link, 2)
        await asyncio.sleep(0)
        interface.now = SEND_TIMEOUT + 0.001
        assert await result(setpoint) == FULL
        interface.full = False
        assert await result(stop) == ""
    assert interface.sent == [2]


async def test_cancelled_sender_sends_nothing_and_later_frames_are_sent(interface):
    async with connected(interface) as link:
        first = await occupied(link, interface)
        cancelled = sending(link, 2)
        await asyncio.sleep(0)
        cancelled.cancel()
        await asyncio.gather(cancelled, return_exceptions=True)
        stop = sending(link, 3)
        await asyncio.sleep(0)
        interface.open.set()
        assert (await result(first), await result(stop)) == ("", "")
    assert interface.sent == [1, 3]


async def test_sender_may_be_cancelled_while_its_frame_is_being_sent(interface):
    async with connected(interface) as link:
        first = await occupied(link, interface)
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        interface.open.set()
        assert await result(sending(link, 2)) == ""
    assert interface.sent == [1, 2]


async def test_full_buffer_is_retried_until_it_accepts_the_frame(interface):
    async with connected(interface) as link:
        interface.full = True
        first = sending(link, 1)
        assert await asyncio.to_thread(interface.refused.wait, BOUND)
        interface.full = False
        assert await result(first) == ""
    assert interface.sent == [1]


async def test_buffer_that_stays_full_fails_the_call_with_its_reason(interface):
    interface.full, interface.passes = True, SEND_TIMEOUT / 4

    async with connected(interface) as link:
        assert await result(sending(link, 1)) == FULL
    assert interface.now == pytest.approx(SEND_TIMEOUT)


async def test_error_contains_the_reason_of_the_interface(interface):
    interface.full = True

    bus = Bus("virtual:queue", lambda frame: None, lambda text: None)
    await bus.open()
    with pytest.raises(DeviceError, match=f"a frame could not be sent: {FULL}"):
        await bus.send(Frame(1))
    await bus.close()


async def test_full_send_queue_refuses_frames(interface):
    async with connected(interface) as link:
        await occupied(link, interface)
        for _ in range(BACKLOG):
            link.post(Frame(2))
        assert await result(sending(link, 3)) == "the send queue is full"


async def test_queued_frames_fail_when_the_connection_is_closed(interface):
    async with connected(interface) as link:
        await occupied(link, interface)
        queued = sending(link, 2)
        await asyncio.sleep(0)
        await link.close()
        assert await result(queued) == BUS_LOST
        assert await result(sending(link, 3)) == BUS_LOST
    assert 2 not in interface.sent
