"""Mapped process data of one node: frames and objects. Pure.

An object in a PDO is encoded as in mapping records: index << 16 | subindex << 8 | bits (CiA 301, 7.5.2.36).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

from msgspec import Struct

from lfield_can.protocols.cia402_tables import NUMBERS

#: Bytes of the longest PDO.
LONGEST = 8
#: Indexes below are types: a dummy entry is a gap in received data (CiA 301, 7.5.2.36).
TYPES_END = 0x20


class Pdo(Struct, frozen=True):
    """One PDO: its number as in manuals, from 1; its frame id; its objects in order."""

    number: int
    id: int
    entries: tuple[int, ...]

    @property
    def fits(self) -> bool:
        """Whether the PDO can be packed: whole bytes that fit a frame."""
        return all(entry & 0x07 == 0 for entry in self.entries) and self.size <= LONGEST

    @property
    def size(self) -> int:
        """The length of the PDO in bytes."""
        return sum(map(size_of, self.entries))

    def places(self) -> Iterator[tuple[int, slice]]:
        """Each object with its bytes."""
        at = 0
        for entry in self.entries:
            yield entry, slice(at, at + size_of(entry))
            at += size_of(entry)


def size_of(entry: int) -> int:
    """Bytes of an object in a PDO."""
    return (entry & 0xFF) // 8


def select_pdos(present: Iterable[Pdo], required: Collection[int]) -> list[Pdo]:
    """The PDOs with the required objects; each object from the PDO with the fewest others."""
    chosen: dict[int, Pdo] = {}
    usable = sorted((pdo for pdo in present if pdo.fits), key=lambda pdo: (len(pdo.entries), pdo.number))
    for entry in required:
        best = next((pdo for pdo in usable if entry in pdo.entries), None)
        if best is not None:
            chosen[best.number] = best
    return list(chosen.values())


class ProcessData:
    """Values from and to a node. The last sent values are stored for frames with several objects."""

    def __init__(
        self, tpdos: Iterable[Pdo] = (), rpdos: Iterable[Pdo] = (), values: Mapping[int, bytes] = {}
    ) -> None:
        self._tpdos = {pdo.id: pdo for pdo in tpdos}
        self._rpdos = {
            entry: pdo
            for pdo in sorted(rpdos, key=lambda pdo: (-len(pdo.entries), -pdo.number))
            for entry in pdo.entries
        }
        self._values = dict(values)

    def is_tpdo(self, identifier: int) -> bool:
        """Whether a frame of this id is a PDO of the node."""
        return identifier in self._tpdos

    def can_send(self, entry: int) -> bool:
        """Whether an object can be sent."""
        return entry in self._rpdos

    def read(self, identifier: int, data: bytes) -> dict[int, int] | None:
        """The used objects of a frame; None for a frame that is too short."""
        pdo = self._tpdos[identifier]
        if len(data) < pdo.size:
            return None
        return {entry: NUMBERS[entry].unpack(data[at])[0] for entry, at in pdo.places() if entry in NUMBERS}

    def on_written(self, index: int, subindex: int, data: bytes) -> None:
        """Stores an object that was written by SDO: no frame may restore its old value."""
        self._values[index << 8 | subindex] = data

    def frame(self, entry: int, value: int) -> tuple[int, bytes]:
        """Id and bytes of the frame for a value. Raises struct.error when it does not fit."""
        pdo = self._rpdos[entry]
        self._values[entry >> 8] = NUMBERS[entry].pack(value)
        padding = bytes(LONGEST)
        parts = (self._values.get(e >> 8, padding)[: size_of(e)] for e in pdo.entries)
        return pdo.id, b"".join(parts)
