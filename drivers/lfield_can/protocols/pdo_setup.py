"""Configures the process data of a drive: with our mapping if the drive permits it, else with its own.

A drive may have COB-ids with bit 30 (no remote frames), fixed mappings, no event timer, or fixed transmission
types. A setting that cannot be written is read and used if it fits; otherwise the drive's answer is
reported. Triggers of a PDO (CiA 301, 7.5.2.37):

timer     every EVERY seconds (transmission type 255, event timer in subindex 5)
  SYNC      without a timer: type 1, and this driver sends SYNC (0x1005) every EVERY seconds
  changes   without both, or at the SYNC after a change (type 0): a value is valid while the node's
            heartbeat is received, and is read once a second
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from enum import IntEnum

from msgspec import Struct, field

from lfield.driver import DeviceError
from lfield_can import log_messages
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.canopen_node import CanopenNode, SdoRefused
from lfield_can.protocols.cia402_tables import RPDO, TPDO, Direction
from lfield_can.protocols.process_data import TYPES_END, Pdo, ProcessData, select_pdos, size_of

#: Bits of a COB-id: not in use; no remote frames. Bit 29 marks a 29-bit id; ours have 11.
UNUSED, NO_REMOTE = 1 << 31, 1 << 30
#: Transmission types: by event and timer, and at every SYNC. Types up to LAST_SYNC need SYNC, types from
#: FIRST_EVENT on need no trigger, and the types between need a remote frame.
BY_EVENT, BY_SYNC, LAST_SYNC, FIRST_EVENT = 255, 1, 240, 254
#: A PDO at every nth SYNC only, or with a longer inhibit time (in 0.1 ms), is too old when it arrives.
MOST_SYNCS, LONGEST_INHIBIT = 5, 1000
#: Examined PDOs of each direction, and objects per PDO.
MAX_PDOS, MOST_ENTRIES = 8, 8

Note = Callable[[str], None]


class PdoTrigger(IntEnum):
    """The event that sends a PDO; the greatest of several applies to all."""

    BY_TIMER = 0
    BY_SYNC = 1
    BY_CHANGES = 2


class PdoConfiguration(Struct, frozen=True):
    """The process data of a node, whether it needs SYNC, and whether values are sent only on change."""

    data: ProcessData = field(default_factory=ProcessData)
    by_sync: bool = False
    by_changes: bool = False


async def configure_pdos(
    node: CanopenNode, number: int, error: Callable[[str], DeviceError], note: Note
) -> PdoConfiguration:
    """Configures all process data of a node. Raises DeviceError with the data that do not fit."""
    sides = [_PdoDirection(node, number, direction, note) for direction in (TPDO, RPDO)]
    received, transmitted = [await side.set_up(error) for side in sides]
    values = {
        entry >> 8: await _value(node, entry)
        for pdo in transmitted
        for entry in pdo.entries
        if entry >> 16 >= TYPES_END
    }
    by_sync = any(side.needs_sync for side in sides)
    return PdoConfiguration(
        ProcessData(received, transmitted, values), by_sync, sides[0].trigger is PdoTrigger.BY_CHANGES
    )


async def _value(node: CanopenNode, entry: int) -> bytes:
    """The present value of an object of a PDO, which is sent unchanged with ours."""
    data = await node.read_raw(entry >> 16, entry >> 8 & 0xFF)
    return data.ljust(size_of(entry), b"\0")


class _PdoDirection:
    """One direction of the process data of one node."""

    def __init__(self, node: CanopenNode, number: int, direction: Direction, note: Note) -> None:
        self._node, self._number, self._direction, self._note = node, number, direction, note
        self._refusals: dict[int, str] = {}
        #: By PDO number from 0: COB-id and mapping as found.
        self._present: dict[int, tuple[int, tuple[int, ...]]] = {}
        #: Unused PDOs, from 0, whose ids others use.
        self._assigned: list[int] = []
        self.trigger = PdoTrigger.BY_TIMER
        #: Whether one of them needs SYNC.
        self.needs_sync = False

    async def set_up(self, error: Callable[[str], DeviceError]) -> list[Pdo]:
        """Configures every PDO that is used. Raises DeviceError."""
        for number in range(MAX_PDOS):
            with suppress(SdoRefused):
                self._present[number] = await self._read(number)
        mapped = await self._map_pdos()
        others = [
            Pdo(number + 1, cob, entries)
            for number, (cob, entries) in self._present.items()
            if number + 1 not in mapped
        ]
        missing = [
            entry for entries in self._direction.mappings for entry in entries if entry in self._refusals
        ]
        used = {**mapped, **{pdo.number: pdo for pdo in select_pdos(others, missing)}}
        self._check(used.values(), missing, error)
        return [await self._use(used[number], used, error) for number in sorted(used)]

    async def _read(self, number: int) -> tuple[int, tuple[int, ...]]:
        mapping = self._direction.mapping + number
        cob = int.from_bytes(await self._node.read_raw(self._direction.record + number, 1), "little")
        count = int.from_bytes(await self._node.read_raw(mapping, 0), "little")
        entries = [
            await self._node.read_raw(mapping, n + 1) for n in range(count if count <= MOST_ENTRIES else 0)
        ]
        return cob, tuple(int.from_bytes(data, "little") for data in entries)

    async def _map_pdos(self) -> dict[int, Pdo]:
        """The PDOs with our mapping, by number."""
        mapped = {}
        for number, entries in enumerate(self._direction.mappings):
            try:
                await self._map(number, entries)
            except SdoRefused as refusal:
                self._refusals.update(dict.fromkeys(entries, refusal.reason))
            else:
                mapped[number + 1] = Pdo(
                    number + 1, self._direction.first + 0x100 * number + self._number, entries
                )
        return mapped

    async def _map(self, number: int, entries: tuple[int, ...]) -> None:
        """Writes a mapping; the PDO must be disabled meanwhile (CiA 301, 7.5.2.36). Raises SdoRefused."""
        cob, present = self._present.get(number, (self._direction.first + 0x100 * number + self._number, ()))
        await self._write(self._direction.record + number, 1, cob | UNUSED, 4)
        if present == entries:
            return
        try:
            await self._write_mapping(number, entries)
        except SdoRefused:
            with suppress(SdoRefused):
                await self._write_mapping(number, present)
            raise

    async def _write_mapping(self, number: int, entries: Sequence[int]) -> None:
        mapping = self._direction.mapping + number
        await self._write(mapping, 0, 0, 1)
        for position, entry in enumerate(entries, 1):
            await self._write(mapping, position, entry, 4)
        await self._write(mapping, 0, len(entries), 1)

    def _check(
        self, used: Iterable[Pdo], missing: Sequence[int], error: Callable[[str], DeviceError]
    ) -> None:
        """Raises DeviceError for a missing required object; logs missing optional ones."""
        mapped = {entry for pdo in used for entry in pdo.entries}
        for entry in missing:
            if entry in mapped:
                continue
            if entry not in self._direction.required:
                self._note(
                    log_messages.PDO_LACKS.line(ability=t.OPTIONAL[entry], reason=self._refusals[entry])
                )
                continue
            name = t.OBJECTS[entry >> 16, 0][0]
            raise error(
                f"no {self._direction.name} contains {name} (0x{entry >> 16:04X}), and it cannot be mapped: "
                f"{self._refusals[entry]}. It has {self._describe()}; map it by the vendor's tool"
            )

    def _describe(self) -> str:
        texts = [
            f"{self._direction.name} {number + 1} with {' '.join(f'0x{e >> 16:04X}' for e in entries)}"
            for number, (_, entries) in self._present.items()
            if entries
        ]
        return ", ".join(texts) or f"no {self._direction.name} with a mapping"

    # -- enabling ---------------------------------------------------------------------------------------

    async def _use(self, pdo: Pdo, used: Mapping[int, Pdo], error: Callable[[str], DeviceError]) -> Pdo:
        """Sets times and id of a PDO, and enables it. Raises DeviceError."""
        number = pdo.number - 1
        record, (cob, _) = self._direction.record + number, self._present.get(number, (0, ()))
        identifier = await self._id(pdo, used)
        # Some drives need the id before the PDO is enabled.
        for unused in dict.fromkeys((cob | UNUSED, identifier | cob & NO_REMOTE | UNUSED)):
            with suppress(SdoRefused):
                await self._write(record, 1, unused, 4)
        self.trigger = max(self.trigger, await self._times(pdo, record, error))
        try:
            await self._write(record, 1, identifier | cob & NO_REMOTE, 4)
        except SdoRefused:
            current = int.from_bytes(await self._node.read_raw(record, 1), "little")
            if current & ~NO_REMOTE != identifier:
                raise
        return Pdo(pdo.number, identifier, pdo.entries)

    async def _id(self, pdo: Pdo, used: Mapping[int, Pdo]) -> int:
        """An id of the node itself: that of the PDO's number, or for a fifth PDO that of an unused one."""
        ids = [self._direction.first + 0x100 * n + self._number for n in range(4)]
        if pdo.number <= len(ids):
            return ids[pdo.number - 1]
        unused = [n for n in range(len(ids)) if n + 1 not in used and n not in self._assigned]
        if not unused:
            return self._present[pdo.number - 1][0] & 0x7FF
        self._assigned.append(unused[0])
        if unused[0] in self._present:
            await self._write(self._direction.record + unused[0], 1, self._present[unused[0]][0] | UNUSED, 4)
        return ids[unused[0]]

    async def _times(self, pdo: Pdo, record: int, error: Callable[[str], DeviceError]) -> PdoTrigger:
        """The best available trigger of a PDO. Raises DeviceError if it is sent for remote frames only."""
        kind = await self._write_number(record, 2, BY_EVENT, 1)
        if not self._direction.is_sent:
            self.needs_sync |= kind <= LAST_SYNC
            return PdoTrigger.BY_TIMER
        if LAST_SYNC < kind < FIRST_EVENT:
            raise error(
                f"{self._direction.name} {pdo.number} is sent only on a remote frame (transmission type "
                f"{kind}), and that cannot be changed; set it to 255 by the vendor's tool"
            )
        await self._lower_inhibit(pdo, record)
        timer = await self._write_number(record, 5, round(t.EVERY * 1000), 2) if kind > LAST_SYNC else 0
        if 0 < timer <= LONGEST_INHIBIT // 10:
            return PdoTrigger.BY_TIMER
        kind = await self._write_number(record, 2, BY_SYNC, 1)
        self.needs_sync |= kind <= LAST_SYNC
        name = f"{self._direction.name} {pdo.number}"
        if 0 < kind <= MOST_SYNCS:
            self._note(log_messages.PDO_BY_SYNC.line(pdo=name))
            return PdoTrigger.BY_SYNC
        self._note(log_messages.PDO_BY_CHANGE.line(pdo=name, type=kind))
        return PdoTrigger.BY_CHANGES

    async def _lower_inhibit(self, pdo: Pdo, record: int) -> None:
        """Makes an inhibit time shorter than the period. Raises SdoRefused."""
        with suppress(SdoRefused):
            previous = int.from_bytes(await self._node.read_raw(record, 3), "little")
            if previous > t.EVERY * 10_000:
                inhibit_time = await self._write_number(record, 3, 0, 2)
                if inhibit_time > LONGEST_INHIBIT:
                    name = f"{self._direction.name} {pdo.number}"
                    self._note(log_messages.PDO_SLOW.line(pdo=name, milliseconds=inhibit_time / 10))

    async def _write_number(self, index: int, subindex: int, value: int, size: int) -> int:
        """Writes a number; returns the resulting value, 0 if there is none."""
        try:
            await self._write(index, subindex, value, size)
        except SdoRefused:
            try:
                return int.from_bytes(await self._node.read_raw(index, subindex), "little")
            except SdoRefused:
                return 0
        return value

    async def _write(self, index: int, subindex: int, value: int, size: int) -> None:
        await self._node.write_raw(index, subindex, value.to_bytes(size, "little"))
