"""How the process data of a foreign drive are set up: ours where it lets us, else those that are there.

A drive may have its COB-ids with bit 30 (it answers no remote frames), mappings that cannot be changed, no
event timer, or transmission types of its own. What cannot be written is read and used, if it fits; what does
not fit is said with what the drive answered. When a PDO comes (CiA 301, 7.5.2.37):

  by its timer    every EVERY seconds (transmission type 255, event timer in subindex 5)
  by SYNC         without a timer: type 1, and this driver sends SYNC (0x1005) every EVERY seconds
  by its changes  without both, or at the SYNC after one (type 0): a value holds while the node's heartbeat is
                  heard, and is read once a second
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import IntEnum

from lfield.driver import DeviceError
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.canopen_node import CanopenNode, SdoRefused
from lfield_can.protocols.cia402_tables import TAKEN, TOLD, Direction
from lfield_can.protocols.process_data import TYPES_END, Pdo, ProcessData, choose, size_of

#: Bits of a COB-id: not in use; no remote frames. With bit 29 its id would have 29 bits; ours have 11.
UNUSED, NO_REMOTE = 1 << 31, 1 << 30
#: Transmission types: by event and timer, and at every SYNC. Up to LAST_SYNC they wait for SYNC, from
#: FIRST_EVENT on for nothing, and between them for a remote frame.
BY_EVENT, BY_SYNC, LAST_SYNC, FIRST_EVENT = 255, 1, 240, 254
#: A PDO that comes at every nth SYNC only, or is held back for longer (in 0.1 ms), is too old when it comes.
MOST_SYNCS, LONGEST_INHIBIT = 5, 1000
#: PDOs of each direction that are looked at, and objects that one can hold.
LOOKED_AT, MOST_ENTRIES = 8, 8

Note = Callable[[str], None]


class Comes(IntEnum):
    """When a PDO comes; of several the greatest holds for all."""

    BY_TIMER = 0
    BY_SYNC = 1
    BY_CHANGES = 2


@dataclass(frozen=True, slots=True)
class Agreed:
    """The process data of a node, whether it needs SYNC, and whether values hold until they change."""

    data: ProcessData = field(default_factory=ProcessData)
    by_sync: bool = False
    by_changes: bool = False


async def agree(node: CanopenNode, number: int, error: Callable[[str], DeviceError], note: Note) -> Agreed:
    """Set up all process data of a node. Raises DeviceError with what does not fit."""
    sides = [_Side(node, number, direction, note) for direction in (TOLD, TAKEN)]
    told, taken = [await side.set_up(error) for side in sides]
    values = {
        entry >> 8: await _value(node, entry)
        for pdo in taken
        for entry in pdo.entries
        if entry >> 16 >= TYPES_END
    }
    by_sync = any(side.waits for side in sides)
    return Agreed(ProcessData(told, taken, values), by_sync, sides[0].comes is Comes.BY_CHANGES)


async def _value(node: CanopenNode, entry: int) -> bytes:
    """What an object of a PDO holds now: it is sent on, unchanged, with what is ours."""
    data = await node.read_raw(entry >> 16, entry >> 8 & 0xFF)
    return data.ljust(size_of(entry), b"\0")


class _Side:
    """One direction of the process data of one node."""

    def __init__(self, node: CanopenNode, number: int, direction: Direction, note: Note) -> None:
        self._node, self._number, self._d, self._note = node, number, direction, note
        self._refusals: dict[int, str] = {}
        #: By the number of the PDO from 0: COB-id and mapping as they were found.
        self._there: dict[int, tuple[int, tuple[int, ...]]] = {}
        #: PDOs, from 0, that are not used, and whose ids others have.
        self._given: list[int] = []
        self.comes = Comes.BY_TIMER
        #: Whether one of them waits for SYNC, be it also for a change.
        self.waits = False

    async def set_up(self, error: Callable[[str], DeviceError]) -> list[Pdo]:
        """Every PDO that is used, in use. Raises DeviceError."""
        for number in range(LOOKED_AT):
            with suppress(SdoRefused):
                self._there[number] = await self._read(number)
        mapped = await self._map_ours()
        rest = [
            Pdo(number + 1, cob, entries)
            for number, (cob, entries) in self._there.items()
            if number + 1 not in mapped
        ]
        missing = [entry for entries in self._d.ours for entry in entries if entry in self._refusals]
        used = {**mapped, **{pdo.number: pdo for pdo in choose(rest, missing)}}
        self._check(used.values(), missing, error)
        return [await self._use(used[number], used, error) for number in sorted(used)]

    async def _read(self, number: int) -> tuple[int, tuple[int, ...]]:
        what = self._d.mapping + number
        cob = int.from_bytes(await self._node.read_raw(self._d.record + number, 1), "little")
        count = int.from_bytes(await self._node.read_raw(what, 0), "little")
        found = [await self._node.read_raw(what, n + 1) for n in range(count if count <= MOST_ENTRIES else 0)]
        return cob, tuple(int.from_bytes(data, "little") for data in found)

    async def _map_ours(self) -> dict[int, Pdo]:
        """By number, the PDOs that could be mapped as we want them."""
        mapped = {}
        for number, entries in enumerate(self._d.ours):
            try:
                await self._map(number, entries)
            except SdoRefused as refused:
                self._refusals.update(dict.fromkeys(entries, refused.reason))
            else:
                mapped[number + 1] = Pdo(number + 1, self._d.first + 0x100 * number + self._number, entries)
        return mapped

    async def _map(self, number: int, entries: tuple[int, ...]) -> None:
        """It must not be in use while it is changed (CiA 301, 7.5.2.36). Raises SdoRefused."""
        cob, present = self._there.get(number, (self._d.first + 0x100 * number + self._number, ()))
        await self._write(self._d.record + number, 1, cob | UNUSED, 4)
        if present == entries:
            return
        try:
            await self._write_mapping(number, entries)
        except SdoRefused:
            with suppress(SdoRefused):
                await self._write_mapping(number, present)
            raise

    async def _write_mapping(self, number: int, entries: Sequence[int]) -> None:
        what = self._d.mapping + number
        await self._write(what, 0, 0, 1)
        for position, entry in enumerate(entries, 1):
            await self._write(what, position, entry, 4)
        await self._write(what, 0, len(entries), 1)

    def _check(
        self, used: Iterable[Pdo], missing: Sequence[int], error: Callable[[str], DeviceError]
    ) -> None:
        """Raise DeviceError for an object that must be there and is not; tell of the others."""
        held = {entry for pdo in used for entry in pdo.entries}
        for entry in missing:
            if entry in held:
                continue
            if entry not in self._d.needed:
                self._note(f"it does not {t.OPTIONAL[entry]}: {self._refusals[entry]}")
                continue
            name = t.OBJECTS[entry >> 16, 0][0]
            raise error(
                f"no {self._d.name} holds {name} (0x{entry >> 16:04X}), and it cannot "
                f"be mapped: {self._refusals[entry]}. It has {self._in_words()}; map it by its maker's tool"
            )

    def _in_words(self) -> str:
        found = [
            f"{self._d.name} {number + 1} with {' '.join(f'0x{entry >> 16:04X}' for entry in entries)}"
            for number, (_, entries) in self._there.items()
            if entries
        ]
        return ", ".join(found) or f"no {self._d.name} with a mapping"

    # -- in use -----------------------------------------------------------------------------------------

    async def _use(self, pdo: Pdo, used: Mapping[int, Pdo], error: Callable[[str], DeviceError]) -> Pdo:
        """Give a PDO its times and its id, and have it in use. Raises DeviceError."""
        number = pdo.number - 1
        record, (cob, _) = self._d.record + number, self._there.get(number, (0, ()))
        identifier = await self._id(pdo, used)
        # An id of its own it is given before it is in use, as some drives want it.
        for unused in dict.fromkeys((cob | UNUSED, identifier | cob & NO_REMOTE | UNUSED)):
            with suppress(SdoRefused):
                await self._write(record, 1, unused, 4)
        self.comes = max(self.comes, await self._times(pdo, record, error))
        try:
            await self._write(record, 1, identifier | cob & NO_REMOTE, 4)
        except SdoRefused:
            now = int.from_bytes(await self._node.read_raw(record, 1), "little")
            if now & ~NO_REMOTE != identifier:
                raise
        return Pdo(pdo.number, identifier, pdo.entries)

    async def _id(self, pdo: Pdo, used: Mapping[int, Pdo]) -> int:
        """One of the node's own: that of its number, or for a fifth PDO that of one which is not used."""
        own = [self._d.first + 0x100 * n + self._number for n in range(4)]
        if pdo.number <= len(own):
            return own[pdo.number - 1]
        free = [n for n in range(len(own)) if n + 1 not in used and n not in self._given]
        if not free:
            return self._there[pdo.number - 1][0] & 0x7FF
        self._given.append(free[0])
        if free[0] in self._there:
            await self._write(self._d.record + free[0], 1, self._there[free[0]][0] | UNUSED, 4)
        return own[free[0]]

    async def _times(self, pdo: Pdo, record: int, error: Callable[[str], DeviceError]) -> Comes:
        """When it comes, at best. Raises DeviceError for one that comes only by remote frames."""
        kind = await self._settle(record, 2, BY_EVENT, 1)
        if not self._d.sent:
            self.waits |= kind <= LAST_SYNC
            return Comes.BY_TIMER
        if LAST_SYNC < kind < FIRST_EVENT:
            raise error(
                f"{self._d.name} {pdo.number} comes only when a remote frame asks for it (transmission type "
                f"{kind}), and that cannot be changed; set it to 255 by its maker's tool"
            )
        await self._lower_inhibit(pdo, record)
        timer = await self._settle(record, 5, round(t.EVERY * 1000), 2) if kind > LAST_SYNC else 0
        if 0 < timer <= LONGEST_INHIBIT // 10:
            return Comes.BY_TIMER
        kind = await self._settle(record, 2, BY_SYNC, 1)
        self.waits |= kind <= LAST_SYNC
        if 0 < kind <= MOST_SYNCS:
            self._note(f"{self._d.name} {pdo.number} has no timer: SYNC asks for it")
            return Comes.BY_SYNC
        self._note(
            f"{self._d.name} {pdo.number} comes only when it changes (transmission type {kind}): "
            "what it told holds while the drive's heartbeat is heard"
        )
        return Comes.BY_CHANGES

    async def _lower_inhibit(self, pdo: Pdo, record: int) -> None:
        """A time that a PDO is held back by must be shorter than its period. Raises SdoRefused."""
        with suppress(SdoRefused):
            held = int.from_bytes(await self._node.read_raw(record, 3), "little")
            if held > t.EVERY * 10_000:
                left = await self._settle(record, 3, 0, 2)
                if left > LONGEST_INHIBIT:
                    self._note(
                        f"{self._d.name} {pdo.number} comes every {left / 10:g} ms at most: an old value"
                    )

    async def _settle(self, index: int, subindex: int, value: int, size: int) -> int:
        """Write a number; what it is then, 0 where there is none."""
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
