"""Where the bytes of blocks lie: each its own run of bytes, or regions of one memory that an engine sees."""

from __future__ import annotations

from typing import Protocol

#: Writable bytes: those of a `bytearray`, or a view of somebody's memory.
Buffer = bytearray | memoryview


class Space(Protocol):
    """Gives the bytes of blocks, and takes them back when nobody has a view of them any more."""

    def room(self, size: int) -> Buffer:
        """So many bytes (8 to a word); what is in them does not matter, it may be anything."""

    def sized(self, data: Buffer, size: int) -> Buffer:
        """The same bytes, so many of them: the first ones of `data`, which is not used any more.

        What is added may be anything.
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


SEPARATE = Separate()
