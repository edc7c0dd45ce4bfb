"""Transfers and messages, compared with the package `dronecan`; and the allocator of node ids."""

from __future__ import annotations

import math

import dronecan
import pytest
from dronecan.transport import Frame as ForeignFrame
from dronecan.transport import Transfer as ForeignTransfer
from hypothesis import given
from hypothesis import strategies as st

from lfield_can.bus.frames import Frame
from lfield_can.drone_can.allocation import HIGHEST, LEARNING, Allocator
from lfield_can.drone_can.messages import (
    ACTUATOR_COMMAND,
    ACTUATOR_STATUS,
    ALLOCATION,
    BATTERY_INFO,
    ESC_STATUS,
    GET_NODE_INFO,
    NODE_STATUS,
    decode,
    encode,
    node_info,
    signatures,
)
from lfield_can.drone_can.transfers import Assembler, Transfer, TransferKind, frames_of

uavcan = dronecan.uavcan
halves = st.floats(width=16, allow_nan=False, allow_infinity=False)
#: Names of the fields here and in foreign messages, with their values.
FOREIGN = {
    ESC_STATUS: (
        uavcan.equipment.esc.Status,
        {
            "error_count": ("error_count", st.integers(0, 2**32 - 1)),
            "voltage": ("voltage", halves),
            "current": ("current", halves),
            "temperature": ("temperature", halves),
            "rpm": ("rpm", st.integers(-(2**17), 2**17 - 1)),
            "power": ("power_rating_pct", st.integers(0, 127)),
            "index": ("esc_index", st.integers(0, 31)),
        },
    ),
    ACTUATOR_STATUS: (
        uavcan.equipment.actuator.Status,
        {
            "index": ("actuator_id", st.integers(0, 255)),
            "position": ("position", halves),
            "force": ("force", halves),
            "speed": ("speed", halves),
            "power": ("power_rating_pct", st.integers(0, 127)),
        },
    ),
    BATTERY_INFO: (
        uavcan.equipment.power.BatteryInfo,
        {
            "temperature": ("temperature", halves),
            "voltage": ("voltage", halves),
            "current": ("current", halves),
            "flags": ("status_flags", st.integers(0, 2047)),
            "health": ("state_of_health_pct", st.integers(0, 127)),
            "charge": ("state_of_charge_pct", st.integers(0, 127)),
            "index": ("battery_id", st.integers(0, 255)),
            "model": ("model_instance_id", st.integers(0, 2**32 - 1)),
        },
    ),
    NODE_STATUS: (
        uavcan.protocol.NodeStatus,
        {
            "uptime": ("uptime_sec", st.integers(0, 2**32 - 1)),
            "health": ("health", st.integers(0, 3)),
            "mode": ("mode", st.integers(0, 7)),
            "vendor_code": ("vendor_specific_status_code", st.integers(0, 65535)),
        },
    ),
}


def foreign_frames(payload, **about):
    transfer = ForeignTransfer(payload=payload, **about)
    return [Frame(f.message_id, bytes(f.bytes), extended=True) for f in transfer.to_frames()]


def read_by_foreign(frames):
    transfer = ForeignTransfer()
    transfer.from_frames([ForeignFrame(frame.id, frame.data) for frame in frames])
    return transfer


def assembled(frames, assembler=None):
    assembler = assembler or Assembler({**signatures(), (NODE_STATUS.id, False): NODE_STATUS.signature})
    return [done for frame in frames if (done := assembler.on_frame(frame, 0.0)) is not None]


@pytest.mark.parametrize("data_type", FOREIGN, ids=lambda each: str(each.id))
@given(st.data(), st.integers(1, 127), st.integers(0, 31))
def test_messages_are_exchanged_with_the_foreign_package(data_type, data, source, number):
    make, fields = FOREIGN[data_type]
    values = {name: data.draw(strategy) for name, (_, strategy) in fields.items()}
    payload = make()
    for name, (foreign, _) in fields.items():
        setattr(payload, foreign, values[name])
    frames = foreign_frames(payload, source_node_id=source, transfer_id=number)
    (transfer,) = assembled(frames)
    assert transfer[:3] == (data_type.kind, source, number)
    decoded, _ = decode(data_type, transfer.data)
    assert {name: decoded[name] for name in values} == values
    sent = list(frames_of(transfer._replace(data=encode(data_type, values)), data_type.signature))
    read = read_by_foreign(sent).payload
    assert {name: getattr(read, foreign) for name, (foreign, _) in fields.items()} == values


def test_command_and_allocation_are_decoded_by_the_foreign_package():
    data = encode(ACTUATOR_COMMAND, {"index": 7, "command_type": 1, "value": -0.5})
    (frame,) = frames_of(Transfer(ACTUATOR_COMMAND.kind, 126, 3, data), ACTUATOR_COMMAND.signature)
    (command,) = read_by_foreign([frame]).payload.commands
    assert (command.actuator_id, command.command_type, command.command_value) == (7, 1, -0.5)
    unique_id = bytes(range(16))
    data = encode(ALLOCATION, {"node": 42}, unique_id)
    frames = list(frames_of(Transfer(ALLOCATION.kind, 126, 0, data), ALLOCATION.signature))
    answer = read_by_foreign(frames).payload
    assert (len(frames), answer.node_id, bytes(answer.unique_id)) == (3, 42, unique_id)


def test_node_info_is_decoded():
    answer = uavcan.protocol.GetNodeInfo.Response()
    answer.name = "org.example.servo"
    answer.software_version.major, answer.software_version.minor = 3, 4
    answer.hardware_version.unique_id = list(range(16))
    answer.hardware_version.certificate_of_authenticity = list(range(100))
    frames = foreign_frames(
        answer, source_node_id=42, dest_node_id=126, service_not_message=True, request_not_response=False
    )
    (transfer,) = assembled(frames)
    assert transfer.kind == TransferKind(GET_NODE_INFO.id, 126)
    info = node_info(transfer)
    assert (info.name, info.unique_id, info.software) == ("org.example.servo", bytes(range(16)), "3.4")
    assert node_info(transfer._replace(data=b"short")) is None
    (request,) = frames_of(Transfer(TransferKind(1, 42, True), 126, 0, b""), GET_NODE_INFO.signature)
    assert read_by_foreign([request]).request_not_response


def esc_frames(source=5, number=1, rpm=100):
    status = uavcan.equipment.esc.Status()
    status.rpm = rpm
    return foreign_frames(status, source_node_id=source, transfer_id=number)


def test_lost_corrupt_late_and_interleaved_frames():
    assembler = Assembler(signatures())
    first, second, third = esc_frames()
    assert assembled([second, third], assembler) == []
    assert assembled([first, third], assembler) == []
    assert assembler.malformed == 1
    changed = second._replace(data=bytes([second.data[0] ^ 1]) + second.data[1:])
    assert assembled([first, changed, third], assembler) == []
    assert assembler.malformed == 2
    # Frames of another node, and of a new transfer of the same node, between the frames of one transfer.
    other = esc_frames(source=6)
    done = assembled([first, other[0], second, other[1], third, other[2]], assembler)
    assert [transfer.source for transfer in done] == [5, 6]
    assert [t.number for t in assembled([first, second, *esc_frames(number=2)], assembler)] == [2]
    assert assembler.on_frame(first, 0.0) is None
    assert assembler.on_frame(second, 1.5) is None
    assert assembler.malformed == 3


@given(st.lists(st.tuples(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.floats(0, 3)), max_size=30))
def test_assembler_survives_any_frames(frames):
    assembler = Assembler(signatures())
    for identifier, data, now in frames:
        transfer = assembler.on_frame(Frame(identifier, data, extended=True), now)
        if transfer is not None:
            for data_type in FOREIGN:
                decode(data_type, transfer.data)
            node_info(transfer)


# -- node ids --------------------------------------------------------------------------------------------

ID = bytes(range(16))


def ask(allocator, unique_id=ID, *, now=10.0, preferred=0):
    """The answers to the three parts of a request."""
    answers = []
    for at, part in enumerate((unique_id[:6], unique_id[6:12], unique_id[12:])):
        data = encode(ALLOCATION, {"node": preferred, "is_first": at == 0}, part)
        answers.append(allocator.on_request(data, now + 0.1 * at))
    return answers


def test_allocator_gives_ids_of_bindings_and_free_ids():
    allocator = Allocator({ID: 42}, frozenset({126, 42, HIGHEST}), 0.0)
    answers = ask(allocator)
    assert [answer.node for answer in answers] == [0, 0, 42]
    assert [len(answer.data) for answer in answers] == [7, 13, 17]
    assert ask(allocator, ID[::-1])[-1].node == HIGHEST - 1
    assert ask(allocator, ID[::-1])[-1].node == HIGHEST - 1
    allocator.on_node(HIGHEST - 2)
    assert ask(allocator, bytes(16))[-1].node == HIGHEST - 3
    assert ask(allocator, bytes([1] * 16), preferred=42)[-1].node == 43


def test_early_mixed_or_unordered_requests_are_ignored():
    allocator = Allocator({ID: 42}, frozenset(), 0.0)
    assert ask(allocator, now=LEARNING - 0.5) == [None, None, None]
    follow = encode(ALLOCATION, {}, ID[6:12])
    assert allocator.on_request(follow, 20.0) is None
    first = encode(ALLOCATION, {"is_first": 1}, ID[:6])
    assert allocator.on_request(first, 20.0) is not None
    assert allocator.on_request(follow, 21.0) is None
    assert allocator.on_request(b"", 21.0) is None
    assert allocator.on_request(first[:4], 21.0) is None


def test_allocator_without_a_free_id_does_not_answer():
    allocator = Allocator({}, frozenset(range(1, 126)), 0.0)
    assert ask(allocator)[-1] is None


def test_unknown_values_are_nan():
    status = uavcan.equipment.actuator.Status()
    status.force = math.nan
    (transfer,) = assembled(foreign_frames(status, source_node_id=5, transfer_id=0))
    assert math.isnan(decode(ACTUATOR_STATUS, transfer.data)[0]["force"])
