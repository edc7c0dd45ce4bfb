"""Process data in their mapping, and SYNC: pure, or on virtual time."""

from __future__ import annotations

import asyncio
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield_can.bus.frames import Frame
from lfield_can.protocols.cia402_tables import CONTROL, POSITION, STATUS, TO_POSITION, VELOCITY, name_of
from lfield_can.protocols.process_data import Pdo, ProcessData, select_pdos
from lfield_can.timing import Sync

MODE, DIGITAL = 0x60600008, 0x60FE0120


def test_the_pdo_with_the_fewest_other_objects_is_selected():
    lone, shared, crowd = Pdo(4, 0, (CONTROL,)), Pdo(1, 0, (CONTROL, TO_POSITION)), Pdo(2, 0, (CONTROL, MODE))
    assert select_pdos([shared, crowd, lone], [CONTROL]) == [lone]
    assert select_pdos([shared, crowd, lone], [CONTROL, TO_POSITION]) == [lone, shared]
    assert select_pdos([crowd], [TO_POSITION]) == []
    # Single bits, and more than fits in a frame, cannot be packed here.
    assert (
        select_pdos([Pdo(1, 0, (CONTROL, 0x60FE0101)), Pdo(2, 0, (CONTROL, *3 * (DIGITAL,)))], [CONTROL])
        == []
    )


def test_frame_carries_the_newest_value_of_each_object():
    pdo = Pdo(1, 0x209, (CONTROL, MODE, TO_POSITION))
    data = ProcessData((), (pdo,), {0x604000: b"\6\0", 0x606000: b"\1", 0x607A00: struct.pack("<i", -5)})
    assert data.frame(CONTROL, 0x0F) == (0x209, b"\x0f\0\1" + struct.pack("<i", -5))
    data.on_written(0x6060, 0, b"\x08")
    data.on_written(0x607A, 0, struct.pack("<i", 7))
    assert data.frame(CONTROL, 0x2)[1] == b"\2\0\x08" + struct.pack("<i", 7)
    assert data.frame(TO_POSITION, 9)[1] == b"\2\0\x08" + struct.pack("<i", 9)


def test_gaps_are_filled_with_zeros():
    data = ProcessData((), (Pdo(1, 0x209, (0x00050008, CONTROL)),))
    assert data.frame(CONTROL, 0x0F) == (0x209, b"\0\x0f\0")


@given(st.binary(max_size=12))
def test_any_pdo_bytes_are_decoded_or_too_short(data):
    mapped = ProcessData((Pdo(1, 0x189, (0x603F0010, STATUS, POSITION)),))
    found = mapped.read(0x189, data)
    assert (found is None) == (len(data) < 8)
    assert found is None or set(found) == {STATUS, POSITION}


@pytest.mark.parametrize(
    ("index", "name"),
    [
        (0x1801, "parameters of TPDO 2"),
        (0x1600, "mapping of RPDO 1"),
        (0x606C, "velocity"),
        (0x2000, "object"),
    ],
)
def test_objects_have_names(index, name):
    assert name_of(index, 0) == name


def test_one_sync_serves_all_nodes_that_require_it():
    sent: list[Frame] = []

    async def scenario():
        sync = Sync(LoopClock(), sent.append, 0.1)
        sync.require(5, 0x80)
        sync.require(6, 0x80)
        await asyncio.sleep(1.05)
        assert sent == 10 * [Frame(0x80)]
        sync.release(5)
        await asyncio.sleep(1.0)
        assert len(sent) == 20
        sync.release(6)
        sync.release(6)
        await asyncio.sleep(1.0)
        assert len(sent) == 20

    run_jumping(scenario())


def test_velocity_is_decoded_as_signed():
    assert ProcessData((Pdo(1, 1, (VELOCITY,)),)).read(1, struct.pack("<i", -3)) == {VELOCITY: -3}
