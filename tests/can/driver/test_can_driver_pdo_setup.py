"""The configuration of process data on drives that refuse some writes: records without a bus."""

from __future__ import annotations

import asyncio
import struct

import pytest

from lfield.driver import DeviceError
from lfield_can.protocols import cia402_setup
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.canopen_node import SdoRefused
from lfield_can.protocols.pdo_setup import configure_pdos

NODE = 9
OLD, UNUSED = 0x1E5, 1 << 31


class Records:
    """The records of a drive; `refuses(index, subindex, value, now)` refuses a write."""

    def __init__(self, refuses=lambda index, subindex, value, now: False, *, kind=255, timer=0, **objects):
        self.refuses = refuses
        self.values = {(entry >> 16, 0): 0 for entry in t.NUMBERS}
        self.values |= {(int(name[1:], 16), 0): value for name, value in objects.items()}
        for record, mapping, first, parameters in (
            (0x1800, 0x1A00, 0x180, t.TPDO.mappings),
            (0x1400, 0x1600, 0x200, t.RPDO.mappings),
        ):
            for number, entries in enumerate(parameters):
                self.values |= {
                    (record + number, 1): first + 0x100 * number + NODE,
                    (record + number, 2): kind if record == 0x1800 else 255,
                    (record + number, 5): timer,
                    (mapping + number, 0): len(entries),
                    **{(mapping + number, n): entry for n, entry in enumerate(entries, 1)},
                }

    async def read_raw(self, index, subindex):
        if (index, subindex) not in self.values:
            raise SdoRefused("axis", "no such object")
        return struct.pack("<I", self.values[index, subindex])

    async def read(self, index, subindex=0):
        return int.from_bytes(await self.read_raw(index, subindex), "little")

    async def write_raw(self, index, subindex, data):
        value, now = int.from_bytes(data, "little"), self.values.get((index, subindex))
        if now is None or self.refuses(index, subindex, value, now):
            raise SdoRefused("axis", "refused")
        self.values[index, subindex] = value


def configure(records):
    """The resulting configuration, and the notes."""
    notes = []
    error = lambda text: DeviceError("axis", text)  # noqa: E731
    return asyncio.run(configure_pdos(records, NODE, error, notes.append)), notes


def fixed(*subindexes):
    """Refuse writes to these subindexes of TPDO parameters, and to every mapping."""
    return lambda index, subindex, value, now: (
        index & 0xFE00 == 0x1A00 or (index & 0xFF00 == 0x1800 and subindex in subindexes)
    )


@pytest.mark.parametrize(
    ("kind", "timer", "by_sync", "by_changes"),
    [
        (255, 20, False, False),
        (254, 20, False, False),
        (254, 0, False, True),
        (1, 0, True, False),
        (5, 0, True, False),
        (6, 0, True, True),
        (0, 0, True, True),
    ],
)
def test_every_fixed_transmission_type_is_supported(kind, timer, by_sync, by_changes):
    """With type 0 a change is sent at the next SYNC: without a SYNC it would never be sent."""
    found, notes = configure(Records(fixed(1, 2, 5), kind=kind, timer=timer))
    assert (found.by_sync, found.by_changes) == (by_sync, by_changes)
    assert any("only on change" in note for note in notes) is by_changes


@pytest.mark.parametrize("kind", [252, 253])
def test_tpdo_on_remote_request_only_is_refused(kind):
    with pytest.raises(DeviceError, match=f"TPDO 1 is sent only on a remote frame .* type {kind}"):
        configure(Records(fixed(1, 2, 5), kind=kind, timer=20))


def test_cob_id_is_changed_while_the_pdo_is_disabled():
    """CiA 301, 7.5.2.35, read strictly: a write changes bit 31 or the id, not both."""

    def refuses(index, subindex, value, now):
        return index == 0x1800 and subindex == 1 and (now ^ value) >> 31 and (now ^ value) & 0x7FF

    records = Records(refuses)
    records.values[0x1800, 1] = OLD
    assert configure(records)[0].data.is_tpdo(0x180 + NODE)
    assert records.values[0x1800, 1] == 0x180 + NODE


def test_dummy_entries_of_an_rpdo_are_filled_with_zeros():
    """Entries of data types (CiA 301, 7.5.2.36) are neither read nor sent as objects."""
    records = Records(lambda index, subindex, value, now: index & 0xFE00 == 0x1600)
    records.values |= {
        (0x1600, 0): 3,
        (0x1600, 1): 0x00050008,
        (0x1600, 2): t.CONTROL,
        (0x1600, 3): 0x00060010,
    }
    found, _ = configure(records)
    assert found.data.frame(t.CONTROL, 0x0F) == (0x200 + NODE, b"\0\x0f\0\0\0")


@pytest.mark.parametrize(
    ("present", "words"),
    [(50, ""), (200, ""), (0, "it sends no heartbeat"), (1000, "period of 1000 ms is too long")],
)
def test_fixed_heartbeat_is_accepted_if_its_period_is_short_enough(present, words):
    records = Records(lambda *write: True, x1017=present)

    async def set_it():
        await cia402_setup.set_heartbeat(records, lambda text: DeviceError("axis", text))

    if not words:
        asyncio.run(set_it())
        return
    with pytest.raises(DeviceError, match=words):
        asyncio.run(set_it())
