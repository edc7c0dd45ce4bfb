"""Process data of one node as they are mapped: which frame carries which objects, and where. Pure.

An object in a PDO is written as in mapping records: index << 16 | subindex << 8 | bits (CiA 301, 7.5.2.36).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from lfield_can.protocols.cia402_tables import NUMBERS

#: Bytes of the longest PDO.
LONGEST = 8
#: Below this index are types: a dummy entry is a gap in what a node takes (CiA 301, 7.5.2.36).
TYPES_END = 0x20


@dataclass(frozen=True, slots=True)
class Pdo:
    """One PDO: its number as manuals count, from 1; the id of its frame; its objects in their order."""

    number: int
    id: int
    entries: tuple[int, ...]

    @property
    def fits(self) -> bool:
        """Whether it can be packed here: whole bytes, and no more than a frame holds."""
        return all(entry & 0x07 == 0 for entry in self.entries) and self.size <= LONGEST

    @property
    def size(self) -> int:
        """Its length in bytes."""
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


def choose(there: Iterable[Pdo], wanted: Collection[int]) -> list[Pdo]:
    """Of PDOs as they are, those with the wanted objects; each object by the PDO that holds least else."""
    chosen: dict[int, Pdo] = {}
    sound = sorted((pdo for pdo in there if pdo.fits), key=lambda pdo: (len(pdo.entries), pdo.number))
    for entry in wanted:
        best = next((pdo for pdo in sound if entry in pdo.entries), None)
        if best is not None:
            chosen[best.number] = best
    return list(chosen.values())


class ProcessData:
    """What a node tells and takes. What was sent last is kept, for frames that carry several objects."""

    def __init__(
        self, told: Iterable[Pdo] = (), taken: Iterable[Pdo] = (), values: Mapping[int, bytes] = {}
    ) -> None:
        self._told = {pdo.id: pdo for pdo in told}
        self._taken = {
            entry: pdo
            for pdo in sorted(taken, key=lambda pdo: (-len(pdo.entries), -pdo.number))
            for entry in pdo.entries
        }
        self._values = dict(values)

    def tells(self, identifier: int) -> bool:
        """Whether a frame of this id is one of them."""
        return identifier in self._told

    def takes(self, entry: int) -> bool:
        """Whether an object can be sent."""
        return entry in self._taken

    def read(self, identifier: int, data: bytes) -> dict[int, int] | None:
        """The objects of a frame that are of use here; None for a frame that is too short."""
        pdo = self._told[identifier]
        if len(data) < pdo.size:
            return None
        return {entry: NUMBERS[entry].unpack(data[at])[0] for entry, at in pdo.places() if entry in NUMBERS}

    def written(self, index: int, subindex: int, data: bytes) -> None:
        """An object has been written by SDO: no frame may bring its old value back."""
        self._values[index << 8 | subindex] = data

    def frame(self, entry: int, value: int) -> tuple[int, bytes]:
        """Id and bytes of the frame that sends a value. Raises struct.error when it does not fit."""
        pdo = self._taken[entry]
        self._values[entry >> 8] = NUMBERS[entry].pack(value)
        gap = bytes(LONGEST)
        parts = (self._values.get(e >> 8, gap)[: size_of(e)] for e in pdo.entries)
        return pdo.id, b"".join(parts)
