"""Data of devices: separate packets and frames, and the traffic of a device that sends false data."""

from __future__ import annotations

import asyncio
import importlib.util
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec
from decoder_target import Target
from pymavlink.dialects.v20 import all as dialect
from targets_of_links import pack, unpack

from lfield.clock import ManualClock
from lfield.driver import DeviceBinding
from lfield.driver.serial.serial_framing import Lines, Packets
from lfield.errors import DeviceError
from lfield.testing.driver_bench import bind
from lfield.testing.kept_reports import KeptReports
from lfield_can import PLUGIN as CAN
from lfield_can.bus.error_frames import linux_error
from lfield_can.bus.frames import Frame, Listener
from lfield_can.bus.socketcand import Socketcand
from lfield_can.drone_can.allocation import Allocator
from lfield_can.drone_can.messages import ESC_STATUS, GET_NODE_INFO, RECEIVED, decode, node_info, signatures
from lfield_can.drone_can.transfers import Assembler, Transfer, TransferKind, frames_of
from lfield_can.protocols.sdo import SdoClient
from lfield_dynamixel.bus.packets import Protocol1, Protocol2, crc16, split_fast
from lfield_mavlink import PLUGIN as MAVLINK
from lfield_mavlink.link.dialect import Reader
from lfield_mavlink.vehicle import MavlinkVehicle
from lfield_sim.mavlink.link.codec import PacketWriter

TESTS = Path(__file__).parents[1]


@cache
def bench_of(folder: str, name: str) -> Any:
    """Load a module of the tests of a driver, which are no package."""
    sys.path.append(str(TESTS / folder))
    spec = importlib.util.spec_from_file_location(
        f"{name}_of_{folder.replace('/', '_')}", TESTS / folder / f"{name}.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# -- MAVLink --------------------------------------------------------------------------------------------

_CRC_EXTRA = {kind: message.crc_extra for kind, message in dialect.mavlink_map.items()}


def sealed(packet: bytes) -> bytes:
    """A MAVLink 2 packet with a correct checksum."""
    if len(packet) < 12 or packet[0] != 0xFD:
        return packet
    body = bytearray(packet[1:-2])
    body[0] = min(255, len(body) - 9)
    crc = dialect.x25crc(body)
    crc.accumulate(bytes([_CRC_EXTRA.get(body[6] | body[7] << 8 | body[8] << 16, 0)]))
    return b"\xfd" + bytes(body) + struct.pack("<H", crc.crc)


def vehicle(kind: str) -> MavlinkVehicle:
    """A vehicle before its first message."""
    binding = bind(
        MAVLINK, agent="a", field="fc", endpoint="udp:127.0.0.1:1", options={"system": 1, "kind": kind}
    )
    return MavlinkVehicle(binding, manifest(), ManualClock(), KeptReports("a.fc"), lambda message: None)


@cache
def manifest() -> Any:
    """The manifest of the MAVLink driver."""
    return MAVLINK.read_manifests()["Mavlink"]


def decode_mavlink(data: bytes) -> None:
    """Feed packets with correct checksums, or raw bytes, to a copter and a rover."""
    try:
        tree = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        tree = [data]
    pieces = [piece for piece in tree if isinstance(piece, bytes)] if isinstance(tree, list) else []
    for kind in ("copter", "rover"):
        fc, reader = vehicle(kind), Reader()
        for piece in pieces[:40]:
            for message in reader.feed(sealed(piece)):
                fc.on_message(message)


def _packets() -> list[bytes]:
    """A packet of every message, each after a heartbeat."""
    heartbeat = PacketWriter(1, 1).pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3))
    plain = (_plain(kind, message.unpacker.size) for kind, message in dialect.mavlink_map.items())
    return [pack([heartbeat, sealed(packet)]) for packet in plain]


def _plain(kind: int, size: int) -> bytes:
    payload = bytes(1 + at % 7 for at in range(min(size, 255)))
    return (
        struct.pack("<BBBBBBBHB", 0xFD, len(payload), 0, 0, 0, 1, 1, kind & 0xFFFF, kind >> 16)
        + payload
        + b"\0\0"
    )


# -- a device with false data ---------------------------------------------------------------------------


class FalseDataFilter:
    """Changes some packets of a device, by four bytes of the input for each packet."""

    def __init__(self, data: bytes, seal: Callable[[bytes], bytes], first: int = 0) -> None:
        self._data, self._seal, self._count, self._first = data, seal, 0, first

    def changed_packets(self, packet: bytes) -> list[bytes]:
        """The packets that replace `packet` of the device."""
        at = 4 * self._count % max(4, len(self._data) - 3)
        self._count += 1
        rule = self._data[at : at + 4]
        if len(rule) < 4 or rule[0] < 128:
            return [packet]
        changed, place = bytearray(packet), self._first + rule[1] % max(1, len(packet) - self._first)
        match rule[0] & 7:
            case 0:
                return []
            case 1:
                return [packet, packet]
            case 2:
                del changed[place:]
            case 3:
                changed[place:place] = bytes([rule[2]]) * (rule[3] % 9)
            case 4:
                changed[place : place + 4] = bytes([rule[2]]) * 4
            case _:
                if place < len(changed):
                    changed[place] = rule[2]
        return [self._seal(bytes(changed))]


def play(bench: Any, calls: list[tuple[str, list[Any]]], timeout: float = 400.0) -> None:
    """Call a device as a program does: each call is completed, or fails with a DeviceError."""
    raised: list[dict[str, Any]] = []

    async def scenario(device: Any) -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
        # A guard ends if its devices are not opened.
        await device.open()
        for name, arguments in calls:
            with suppress(DeviceError, TimeoutError):
                async with asyncio.timeout(30.0):
                    await device.execute(name, arguments)
        with suppress(DeviceError, TimeoutError):
            async with asyncio.timeout(30.0):
                await device.make_safe()
        device.moving()
        await asyncio.sleep(1.0)

    with suppress(DeviceError, TimeoutError):
        bench.run(scenario, opened=False, within=timeout)
    for context in raised:
        if "exception" in context and not isinstance(context["exception"], DeviceError):
            raise context["exception"]


def decode_false_vehicle_data(data: bytes) -> None:
    """A flight with an autopilot that sends false data."""
    module = bench_of("mavlink", "conftest")
    flavour = "px4" if data[:1] > b"\x7f" else "ardupilot"
    bench = module.Bench(flavour=flavour)
    changes = FalseDataFilter(data[1:], sealed, first=6)

    def deliver(link: Any, packet: bytes) -> None:
        for piece in changes.changed_packets(packet):
            link.on_data(piece)

    bench.filter = deliver
    plan = [
        ("arm", []),
        ("takeoff", [3.0]),
        ("goTo", [3.0, 0.0, -3.0]),
        ("setVelocity", [1.0, 0.0, 0.0]),
        ("land", []),
    ]
    play(bench, plan)


def decode_false_servo_data(data: bytes) -> None:
    """A joint with a servo that sends false data; a group of two if the first byte is odd, of Feetech if its
    next bit is set.
    """
    module = bench_of("dynamixel/driver", "dynamixel_bench")
    odd, other = bool(data and data[0] & 1), bool(data and data[0] & 2)
    kind = {"fake": "STS3215", "protocol": 0} if other else {}
    bench = module.Bench(
        *((1, 2) if odd else (1,)), limits={"speed": 2.0}, waivers=["device_watchdog"], **kind
    )
    seal = sealed_feetech if other else sealed_dynamixel
    changes, deliver = FalseDataFilter(data[1:], seal, first=4), bench.port._deliver
    bench.port._deliver = lambda packet: [deliver(piece) for piece in changes.changed_packets(packet)]
    moves: list[tuple[str, list[Any]]] = [
        ("torque", [True]),
        ("moveTo", [[0.1, 0.1] if odd else 0.1]),
        ("torque", [False]),
    ]
    play(bench, moves)


def sealed_dynamixel(packet: bytes) -> bytes:
    """A packet of protocol 2.0 with correct length and checksum."""
    if len(packet) < 11 or packet[:3] != b"\xff\xff\xfd":
        return packet
    body = packet[:5] + (len(packet) - 7).to_bytes(2, "little") + packet[7:-2]
    return body + crc16(body).to_bytes(2, "little")


def sealed_feetech(packet: bytes) -> bytes:
    """A packet of protocol 1.0 with correct length and checksum."""
    if len(packet) < 6 or packet[:2] != b"\xff\xff":
        return packet
    body = packet[2:3] + bytes((len(packet) - 4,)) + packet[4:-1]
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def decode_false_drive_data(data: bytes) -> None:
    """An axis with a CiA 402 drive that sends false data."""
    places, drives = bench_of("can", "conftest"), bench_of("can/driver", "can_local_drive")
    bus, drive = places.MemoryBus(), drives.LocalDrive()
    drive.bus = bus
    options = {"protocol": "cia402", "node": 5, "counts": 10_000, "connect": 3.0}
    bench = places.CanBench(_axis(options), bus=bus, fakes=[drive.live])
    _lie_on(bus, data)
    play(bench, [("enable", []), ("moveTo", [1.0, 5.0]), ("setVelocity", [1.0]), ("disable", [])])


def _axis(options: dict[str, Any]) -> DeviceBinding:
    settings = {"limits": {"speed": 20.0}, "waivers": ["no_homing", "device_watchdog"], "ttl": 1.0}
    return bind(
        CAN, "CanAxis", agent="winch", field="axis", endpoint="virtual:test", options=options, **settings
    )


def _lie_on(bus: Any, data: bytes) -> None:
    changes, say = FalseDataFilter(data, lambda frame: frame[:8]), bus.say

    def lie(identifier: int, frame: bytes, *, extended: bool = False) -> None:
        for piece in changes.changed_packets(bytes(frame)):
            say(identifier, piece, extended=extended)

    bus.say = lie


def decode_can_frames(data: bytes) -> None:
    """Feed frames of all ids, of two to nine bytes, to an ODrive axis and a CiA 402 axis while they open."""
    places = bench_of("can", "conftest")
    cia402 = {"protocol": "cia402", "node": 5, "counts": 4096, "connect": 1.0}
    for options in ({"protocol": "odrive", "node": 3, "connect": 1.0}, cia402):
        bus = places.MemoryBus()
        bench = places.CanBench(_axis(options), bus=bus, fakes=[partial(_speak, bus, data)])
        play(bench, [("enable", [])], 60.0)


async def _speak(bus: Any, data: bytes) -> None:
    await asyncio.sleep(0.01)
    at = 0
    while at + 3 <= len(data):
        size, identifier = data[at] & 15, int.from_bytes(data[at + 1 : at + 3], "little")
        bus.say(identifier & 0x7FF, data[at + 3 : at + 3 + min(size, 8)], extended=bool(identifier & 0x8000))
        at += 3 + min(size, 8)
        await asyncio.sleep(0.002)


# -- raw bytes ------------------------------------------------------------------------------------------


def decode_dynamixel(data: bytes) -> None:
    """Feed bytes of a servo bus in pieces to both protocols."""
    for protocol in (Protocol1, Protocol2):
        reader = protocol.reader()
        size = 1 + (data[0] if data else 0)
        for at in range(1, len(data), size):
            for status in reader.feed(data[at : at + size]):
                split_fast(status, (1, 2), 4)
                split_fast(status, (1,), 0)
        assert len(reader._buffer) <= 2048  # type: ignore[attr-defined]


def decode_socketcand(data: bytes) -> None:
    """Feed bytes of a socketcand server in pieces, before and after the greeting."""
    client = Socketcand(Listener(lambda frame: None, linux_error, lambda why: None))
    size = 1 + (data[0] if data else 0)
    for at in range(1, len(data), size):
        client.data_received(data[at : at + size])
    client._answers = None
    client.data_received(data)
    assert len(client._unread) <= 256


def decode_sdo(data: bytes) -> None:
    """Feed answers of a CANopen server, eight bytes each; the first byte selects the running request."""
    client = SdoClient()
    keys = ((0x6064, 0), (0x1018, 1), (0x1008, 0))
    busy = False
    for at in range(0, len(data), 9):
        if not busy:
            key = keys[data[at] % 3]
            client.upload(key) if data[at] & 4 else client.download(key, b"\1\2")
            busy = True
        effects = client.on_response(data[at + 1 : at + 9]) if data[at] & 8 else client.on_timeout()
        busy = not any(type(effect).__name__ in ("Done", "Refused", "Failed") for effect in effects)


def decode_dronecan(data: bytes) -> None:
    """Feed frames of nodes and of an allocator's clients: an id, a length, and up to eight bytes."""
    assembler = Assembler(signatures())
    allocator = Allocator({bytes(16): 42}, frozenset({126}), -10.0)
    for number, at in enumerate(range(0, len(data), 13)):
        identifier = int.from_bytes(data[at : at + 4], "little") & 0x1FFFFFFF
        frame = Frame(identifier, data[at + 5 : at + 5 + min(8, data[min(at + 4, len(data) - 1)])], True)
        if (transfer := assembler.on_frame(frame, 0.01 * number)) is None:
            continue
        allocator.on_request(transfer.data, 0.01 * number)
        node_info(transfer)
        for data_type in RECEIVED:
            decode(data_type, transfer.data)


def decode_serial(data: bytes) -> None:
    """Feed bytes of a serial device to the readers of lines and of packets."""
    packets = Packets(b"\xb5\x62", 6, lambda head: 8 + (head[4] | head[5] << 8), lambda frame: frame[-1] != 0)
    for framer in (Lines(), Lines(b"\r\n", longest=40), packets):
        size = 1 + (data[0] if data else 0)
        for at in range(1, len(data), size):
            framer.feed(data[at : at + size])


def _dynamixel_seeds() -> list[bytes]:
    answers = [Protocol2.encode(1, 0x55, b"\0" + bytes(range(n))) for n in (0, 4, 10, 30)]
    fast = Protocol2.encode(254, 0x55, b"\0\1abcd\0\0\0\2abcd")
    old = b"\xff\xff\1\4\0\5\6" + bytes((~(1 + 4 + 5 + 6) & 0xFF,))
    return [bytes([size]) + b"".join(answers) + fast + old for size in (0, 6, 255)]


def _lies() -> list[bytes]:
    return [
        bytes([first]) + bytes(40) + bytes([rule, 9, 255, 3]) + bytes(60)
        for first in (0, 129, 200)
        for rule in (129, 132, 133)
    ]


def _servo_inputs() -> list[bytes]:
    """Inputs for one and two servos, also of Feetech."""
    return [*_lies(), *(bytes([first]) + lie[1:] for first in (2, 3) for lie in _lies()[:2])]


def _socketcand_seeds() -> list[bytes]:
    return [b"\5< hi >< ok >< ok >< frame 123 1.0 0011 22 >< error 20000004 1.0 >", b"\xff" + b"<" * 600]


def _sdo_seeds() -> list[bytes]:
    segments = b"\x0e\x41\x08\x10\0\x14\0\0\0\x08\0abcdefg\x08\x11hijklmn"
    return [b"\x0c\x4f\x64\x60\0\7\0\0\0" * 3, segments, b"\x08\x60\x64\x60\0\0\0\0\0" * 2]


def _frame_seeds() -> list[bytes]:
    answers = b"\x08\x85\5" + bytes(8) + b"\x04\x61\0\1\0\0\0" + b"\x02\x05\7\5\0" * 3
    return [answers + b"\x08\x69\0" + b"\xff" * 8]


def _dronecan_seeds() -> list[bytes]:
    frames = [
        *frames_of(Transfer(ESC_STATUS.kind, 5, 1, bytes(14)), ESC_STATUS.signature),
        *frames_of(Transfer(TransferKind(1, 126), 5, 1, bytes(60)), GET_NODE_INFO.signature),
    ]
    return [
        b"".join(
            frame.id.to_bytes(4, "little") + bytes([len(frame.data)]) + frame.data.ljust(8, b"\0")
            for frame in frames
        )
    ]


def _serial_seeds() -> list[bytes]:
    return [b"\7one\ntwo\r\nthree\n\xb5\x62\1\2\2\0ab\1\1\xb5\x62"]


_SOCKETCAND = (b"< frame ", b" >", b"<", b">", b"< error ", b"1FFFFFFF", b"7ff", b"+1_0", b"-1")

TARGETS = (
    Target("mavlink", _packets, decode_mavlink, True),
    Target("mavlink-lies", _lies, decode_false_vehicle_data, share=40),
    Target("dynamixel", _dynamixel_seeds, decode_dynamixel, tokens=(b"\xff\xff\xfd\0", b"\xff\xff")),
    Target("dynamixel-lies", _servo_inputs, decode_false_servo_data, share=2),
    Target("socketcand", _socketcand_seeds, decode_socketcand, tokens=_SOCKETCAND),
    Target("sdo", _sdo_seeds, decode_sdo),
    Target("can-frames", _frame_seeds, decode_can_frames),
    Target("dronecan", _dronecan_seeds, decode_dronecan),
    Target("can-lies", _lies, decode_false_drive_data, share=10),
    Target("serial", _serial_seeds, decode_serial, tokens=(b"\xb5\x62", b"\n")),
)
