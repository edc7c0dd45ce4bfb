"""Adapters that echo the sent bytes, and two servos with the same id, for all protocols."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import START, Bench, call
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import DeviceError
from lfield_dynamixel.bus.packets import EchoFilter, Protocol1, Protocol2, Reader1, Status, harmless
from lfield_dynamixel.bus.servo_chain import FAST_RETRY_READS, Chain, Node
from lfield_sim.dynamixel.ax_series import make_servo
from lfield_sim.dynamixel.servo_model import model_named

ECHO = "echo removed: the adapter returns what is sent"


def bench(protocol: int, *ids: int, **more) -> Bench:
    if protocol == 2:
        return Bench(*ids, **more)
    fake = "AX-12A" if protocol else "STS3215"
    return Bench(*ids, fake=fake, protocol=protocol, waivers=["device_watchdog"], **more)


def add_duplicate(b: Bench, number: int, *, delay: int | None = None, angle: float = 0.3) -> None:
    """Add a servo with an id that is already on the bus."""
    first = b.servos[number]
    servo = make_servo(model_named(first.model.name), START)
    for name in ("id", "baud_rate"):
        servo.table.put(name, first.table[name])
    if delay is not None:
        servo.table.put("return_delay_time", delay)
    servo.motion.motor.angle += angle
    b.chain.servos.append(servo)
    b.chain._names[id(servo)] = str(number)


@pytest.mark.parametrize("ids", [(1,), (1, 2, 3)])
@pytest.mark.parametrize("protocol", [1, 2])
def test_echoing_adapter_is_used_like_one_without_echo(protocol, ids):
    b = bench(protocol, *ids, limits={"speed": 2.0})
    b.fault("echo=true")

    async def scenario(device):
        await call(device, "torque", True)
        goal = [0.5 + 0.1 * number for number in ids]
        await call(device, "moveTo", goal if len(ids) > 1 else goal[0])
        observed = b.values["positions"] if len(ids) > 1 else [b.values["position"]]
        assert observed == pytest.approx(goal, abs=0.02)
        await device.make_safe()
        await call(device, "torque", False)
        await asyncio.sleep(2.0)
        assert b.values["torqueOn"] is False

    b.run(scenario)
    assert b.notes.count(ECHO) == 1
    assert not any("does not answer" in note for note in b.notes)


@pytest.mark.parametrize("damaged", [1, 2])
def test_damaged_first_echo_does_not_hide_the_echo(damaged):
    """The first bytes after the opening of a port may be damaged."""
    b = bench(1, 1)
    b.fault("echo=true")
    remaining = [damaged]

    async def scenario(servo):
        received = b.port.events.received

        def damage_first(data):
            if remaining[0]:
                remaining[0] -= 1
                data = bytes([data[0] ^ 0x40]) + data[1:]
            received(data)

        b.port.events.received = damage_first
        await servo.open()
        await call(servo, "torque", True)
        await call(servo, "moveTo", 0.4)

    b.run(scenario, opened=False)
    assert b.notes.count(ECHO) == 1


@pytest.mark.parametrize("protocol", [1, 2])
def test_adapter_without_echo_gives_no_echo_note(protocol):
    b = bench(protocol, 1)

    async def scenario(servo):
        await call(servo, "torque", True)

    b.run(scenario)
    assert ECHO not in b.notes


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_echo_is_not_mistaken_for_the_answer_of_a_servo(protocol):
    b = bench(protocol, 1)
    b.fault("echo=true", "dead@1=true")

    async def scenario(servo):
        with pytest.raises(DeviceError, match="does not answer"):
            await servo.open()

    b.run(scenario, opened=False)


@pytest.mark.parametrize("protocol", [1, 2])
def test_dead_servo_behind_an_echo_is_reported_and_found_again(protocol):
    b = bench(protocol, 1)
    b.fault("echo=true")

    async def scenario(servo):
        b.fault("dead@1=true")
        await b.until(lambda: any("not responding" in note for note in b.notes))
        b.fault("dead@1=false")
        await b.until(lambda: any("responding again" in note for note in b.notes))

    b.run(scenario)


@pytest.mark.parametrize("first", [False, True])
def test_port_may_be_plugged_in_again_with_another_adapter(first):
    b = bench(1, 1)
    b.fault(f"echo={str(first).lower()}")

    async def scenario(servo):
        b.port.unplug()
        await asyncio.sleep(0.5)
        b.fault(f"echo={str(not first).lower()}")
        b.port.plug()
        await asyncio.sleep(1.0)
        await call(servo, "torque", True)
        await call(servo, "moveTo", 0.4)

    b.run(scenario)
    assert b.notes.count(ECHO) == 1


def test_motion_ends_with_lost_and_damaged_answers_behind_an_echo():
    b = bench(1, 1, 2)
    b.fault("echo=true", "lose=0.05", "corrupt=0.05", "noise=0.05")

    async def scenario(group):
        await call(group, "torque", True)
        await call(group, "setProfile", 2.0, 0.0)
        await call(group, "moveTo", [0.6, 0.6])
        assert b.values["positions"] == pytest.approx([0.6, 0.6], abs=0.03)

    b.run(scenario)


def test_protocol_1_instruction_equals_an_answer_byte_for_byte():
    """A ping equals an answer with a voltage error; so the echo is detected before the first request."""
    (status,) = Reader1().feed(Protocol1.encode(1, 1))
    assert (status.number, status.error, status.data) == (1, 1, b"")


@on_bench(bench, 1, 1, opened=False)
async def test_servo_whose_answer_equals_its_ping_is_found(b, servo, /):
    b.fault("sag=8.0")
    b.chain.receive(b"", asyncio.get_running_loop().time())
    await asyncio.sleep(1.0)
    assert "AX-12A 1" in await servo.open()
    assert "voltage" in b.values["fault"]


@given(
    st.lists(st.binary(min_size=1, max_size=12), max_size=6),
    st.lists(st.binary(max_size=12), max_size=6),
    st.data(),
)
def test_echo_is_removed_for_every_split_of_the_bytes(sent, answers, data):
    """Each answer follows the echo of its packet, and the pieces of the stream have any size."""
    echo, stream = EchoFilter(), b""
    for at, packet in enumerate(sent):
        answer = answers[at] if at < len(answers) else b""
        whole, passed = packet + answer, b""
        echo.on_sent(packet)
        while whole:
            size = data.draw(st.integers(1, len(whole)))
            passed += echo.strip(whole[:size])
            whole = whole[size:]
        assert passed == answer
        stream += passed


@pytest.mark.parametrize("codec", [Protocol1, Protocol2])
def test_echo_probe_changes_nothing(codec):
    b = bench(codec.version, 1)
    before = dict(b.servos[1].table._values)
    assert b.chain.receive(harmless(codec), START, 1_000_000) == []
    assert b.servos[1].table._values == before


# -- two servos with the same id ---------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", [0, 1, 2])
@pytest.mark.parametrize(
    ("delay", "words"), [(254, "two servos answer to the id 1"), (None, "are damaged: check whether two")]
)
def test_two_servos_with_the_same_id_are_reported(protocol, delay, words):
    b = bench(protocol, 1)
    b.servos[1].table.put("return_delay_time", 0 if delay else b.servos[1].table["return_delay_time"])
    add_duplicate(b, 1, delay=delay)

    async def scenario(servo):
        with pytest.raises(DeviceError, match=words):
            await servo.open()

    b.run(scenario, opened=False)


def test_added_servo_with_the_same_id_is_reported_and_motion_refused():
    b = bench(2, 1)
    b.servos[1].table.put("return_delay_time", 0)

    async def scenario(servo):
        await call(servo, "torque", True)
        b.fault("dead@1=true")
        await b.until(lambda: any("not responding" in note for note in b.notes))
        add_duplicate(b, 1, delay=254)
        b.fault("dead@1=false")
        await b.until(lambda: any("two servos answer to the id 1" in note for note in b.notes))
        with pytest.raises(DeviceError, match="two servos answer to the id 1"):
            await call(servo, "moveTo", 0.5)
        await asyncio.sleep(5.0)
        b.chain.servos.pop()
        await b.until(lambda: any("responding again" in note for note in b.notes))
        await call(servo, "torque", True)
        await call(servo, "moveTo", 0.5)

    b.run(scenario)
    assert sum("two servos" in note for note in b.notes) == 1


@pytest.mark.parametrize("ids", [(1,), (1, 2)])
@pytest.mark.few(6)
@pytest.mark.parametrize("protocol", [0, 1, 2])
@pytest.mark.parametrize("delay", [254, None])
def test_added_servo_with_the_same_id_stops_the_motion(protocol, ids, delay):
    """Answers of the second servo follow the answers of the first, or damage them. The motion fails."""
    b = bench(protocol, *ids, limits={"speed": 2.0})
    if delay:
        b.servos[1].table.put("return_delay_time", 0)

    def goals(angle):
        return [angle] * len(ids) if len(ids) > 1 else angle

    async def scenario(device):
        await call(device, "torque", True)
        await call(device, "setProfile", 0.2, 0.0)
        motion = asyncio.ensure_future(call(device, "moveTo", goals(2.0)))
        await asyncio.sleep(1.0)
        add_duplicate(b, 1, delay=delay)
        start = asyncio.get_running_loop().time()
        with pytest.raises(DeviceError, match=r"two servos|come damaged|does not answer"):
            await motion
        # With one servo, the state of the torque is not known.
        assert b.values["torqueOn"] is (len(ids) > 1)
        assert asyncio.get_running_loop().time() - start < 2.5
        await b.until(lambda: any("two servos" in note for note in b.notes))
        with pytest.raises(DeviceError, match="two servos"):
            await call(device, "moveTo", goals(0.5))

    b.run(scenario)
    assert sum("two servos" in note for note in b.notes) == 1


@pytest.mark.parametrize("protocol", [1, 2])
def test_lost_late_and_damaged_answers_do_not_report_a_second_servo(protocol):
    b = bench(protocol, 1)
    b.fault("lose=0.1", "corrupt=0.1", "noise=0.1", "delay=0.01")

    async def scenario(servo):
        await servo.open()
        await asyncio.sleep(20.0)

    b.run(scenario, opened=False)
    assert not any("id" in note for note in b.notes)


class SlowBus:
    """A bus whose servos answer sync reads, but fast sync reads only if `supports_fast` is true."""

    gone = ""

    def __init__(self) -> None:
        self.supports_fast, self.kinds = False, []

    async def exchange(self, protocol, packet, numbers, size, *, urgency):
        fast = packet[7] == 0x8A
        self.kinds.append(fast)
        if not fast:
            return [Status(number, 0, bytes(size)) for number in numbers]
        if not self.supports_fast:
            return []
        part = b"".join(bytes((0, number)) + bytes(4 + 2) for number in (1, 2))
        return [Status(0xFE, 0, part[1:-2])]


def test_fast_reads_are_tried_again_after_a_failure():
    bus, nodes = SlowBus(), [Node(1), Node(2)]
    chain = Chain(bus)

    async def read(times: int) -> list[bool]:
        for _ in range(times):
            bus.kinds.clear()
            await chain.sync_read(nodes, 132, 4)
        return bus.kinds

    async def scenario():
        assert await read(10) == [False]
        bus.supports_fast = True
        await read(FAST_RETRY_READS)
        assert await read(1) == [True]
        assert await read(10) == [True]

    asyncio.run(scenario())
