"""Parcels: what a call gave or threw, as bytes that wait for whoever has begun it (decision 46).

A plain value is its word. Anything else is a deep copy in the image of a small block, whose root is where
an agent's block has its object.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import HEADER_WORDS, W_SELF, Layouts
from lfield.vm.memory.space import SEPARATE, Space

#: The bytes of a plain one.
WORD = 8


def plain_parcel(word: int) -> bytes:
    """The parcel of a value that is one word; of null and of nothing too."""
    return word.to_bytes(WORD, "little", signed=True)


def parcel_of(source: Block, place: int, digest: bytes, layouts: Layouts) -> bytes:
    """The parcel of the thing at `place`; `digest` is of the program."""
    return parcel_made(digest, lambda block: deep_copy(source, [place], block, layouts)[0], source.space)


def parcel_made(digest: bytes, make: Callable[[Block], int], space: Space = SEPARATE) -> bytes:
    """The parcel of a thing that `make` puts into the block it is given; that may raise Full.

    The block has its bytes from `space`: best that of the block which is copied from.
    """
    words = 0
    while True:
        room = HEADER_WORDS + words
        block = Block(space.room(8 * room), HEADER_WORDS, room, space)
        empty = Block.empty(digest, HEADER_WORDS)
        block.w[:HEADER_WORDS] = empty.w[:HEADER_WORDS]
        try:
            block.w[W_SELF] = make(block)
            return bytes(block.image())
        except Full as full:
            # Twice what it lacks, as it may be made of many small things.
            words = 2 * block.lacking(HEADER_WORDS, full)


def open_parcel(parcel: bytes, target: Block, layouts: Layouts) -> int:
    """The word of what is in a parcel, copied into the target; raises Full before it writes anything."""
    if len(parcel) == WORD:
        return int.from_bytes(parcel, "little", signed=True)
    words = len(parcel) // 8
    data = target.space.room(len(parcel))
    data[:] = parcel
    block = Block(data, words, words, target.space)
    return deep_copy(block, [block.w[W_SELF]], target, layouts)[0]
