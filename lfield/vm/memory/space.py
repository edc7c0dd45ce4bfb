"""Where the bytes of blocks lie: each its own run of bytes, or regions of one memory that an engine sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from lfield.vm.memory.layout import Layouts
from lfield.vm.memory.shapes import Shapes, Stances

#: Writable bytes: those of a `bytearray`, or a view of somebody's memory.
Buffer = bytearray | memoryview
#: Where things begin, each with the low half of its header, and the places of tickets, in their order.
Walked = tuple[Mapping[int, int], list[int]]


class Space(Protocol):
    """Gives the bytes of blocks, and takes them back when nobody has a view of them any more.

    What is done with whole heaps it may do itself, the same as the Python beside it and to the same bytes.
    """

    def room(self, size: int) -> Buffer:
        """So many bytes (8 to a word); what is in them does not matter, it may be anything."""

    def sized(self, data: Buffer, size: int) -> Buffer:
        """The same bytes, so many of them: the first ones of `data`, which is not used any more.

        What is added may be anything.
        """

    def collected(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        """Copy what is alive (`lfield.vm.memory.collector`) behind the header that is in the target already.

        Returns the new top in words; 0, and nothing happens, where the space cannot.
        """

    def copied(
        self,
        source: Buffer,
        used: int,
        roots: list[int],
        target: Buffer,
        top: int,
        end: int,
        layouts: Layouts,
    ) -> tuple[list[int], int] | None:
        """Copy what the roots lead to (`lfield.vm.memory.copier`) to `top`; the source has `used` words.

        Returns the references to the copies and the new top; as the top, where there is no room before
        `end`, the negated number of the words needed; None where the space cannot.
        """

    def walked(self, data: Buffer, heap: int, top: int, shapes: Shapes) -> Walked | None:
        """What there is between two words.

        Sizes, texts, proxies and references are sound then; None where the space cannot tell
        (`lfield.vm.memory.soundness`). It is valid until the next one.
        """

    def travels(self, data: Buffer, top: int, stances: Stances) -> bool:
        """Whether it is sure that a travelling coordinator's block of so many words is sound in all respects.

        It begins as it must: magic, version and program. False where the space cannot tell.
        """


class Separate:
    """Every block has bytes of its own: what serves where no engine wants them in one place."""

    def room(self, size: int) -> bytearray:
        return bytearray(size)

    def sized(self, data: Buffer, size: int) -> Buffer:
        if not isinstance(data, bytearray):
            made = bytearray(size)
            kept = min(size, len(data))
            made[:kept] = data[:kept]
            return made
        data.extend(bytes(max(0, size - len(data))))
        del data[size:]
        return data

    def collected(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        return 0

    def copied(
        self,
        source: Buffer,
        used: int,
        roots: list[int],
        target: Buffer,
        top: int,
        end: int,
        layouts: Layouts,
    ) -> tuple[list[int], int] | None:
        return None

    def walked(self, data: Buffer, heap: int, top: int, shapes: Shapes) -> Walked | None:
        return None

    def travels(self, data: Buffer, top: int, stances: Stances) -> bool:
        return False


SEPARATE = Separate()
