"""Serialised results of pending calls: a value or exception as bytes until it is fetched (decision 46).

A plain value is its word. Anything else is a deep copy in the image of a small block, whose root is the word
of an agent's object.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import HEADER_WORDS, W_SELF, Layouts

#: Bytes of a plain one.
WORD_SIZE = 8


def serialise_word(word: int) -> bytes:
    """A value that is one word; also null and no value."""
    return word.to_bytes(WORD_SIZE, "little", signed=True)


def serialise_object(source: Block, place: int, digest: bytes, layouts: Layouts) -> bytes:
    """The object at `place`; `digest` is of the program."""
    return serialise_built(digest, lambda block: deep_copy(source, [place], block, layouts)[0], source.space)


def serialise_built(
    digest: bytes, make: Callable[[Block], int], space: BlockAllocator = HEAP_ALLOCATOR
) -> bytes:
    """An object that `make` creates in the block it is given; `make` may raise HeapFull.

    The block's bytes are from `space`: preferably that of the source block.
    """
    words = 0
    while True:
        capacity = HEADER_WORDS + words
        block = Block(space.allocate(8 * capacity), HEADER_WORDS, capacity, space)
        empty = Block.empty(digest, HEADER_WORDS)
        block.w[:HEADER_WORDS] = empty.w[:HEADER_WORDS]
        try:
            block.w[W_SELF] = make(block)
            return bytes(block.image())
        except HeapFull as full:
            # Twice the shortage, since it may consist of many small objects.
            words = 2 * block.missing_words(HEADER_WORDS, full)


def deserialise_result(result: bytes, target: Block, layouts: Layouts) -> int:
    """The word of a result, copied into the target. Raises HeapFull before any write."""
    if len(result) == WORD_SIZE:
        return int.from_bytes(result, "little", signed=True)
    words = len(result) // 8
    data = target.space.allocate(len(result))
    data[:] = result
    block = Block(data, words, words, target.space)
    return deep_copy(block, [block.w[W_SELF]], target, layouts)[0]
