"""Serialised results of pending calls: a value or exception as bytes until it is fetched (decision 46).

A plain value is serialised as its word. Any other value is a deep copy in the image of a small block, whose
root is the word of an agent's object.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import HEADER_WORDS, W_SELF, Layouts

#: The size of a plain result in bytes.
WORD_SIZE = 8


def serialise_word(word: int) -> bytes:
    """Serialise a value of one word; also null and no value."""
    return word.to_bytes(WORD_SIZE, "little", signed=True)


def serialise_object(source: Block, place: int, digest: bytes, layouts: Layouts) -> bytes:
    """Serialise the object at `place`; `digest` is the digest of the program."""
    return serialise_built(digest, lambda block: deep_copy(source, [place], block, layouts)[0], source.space)


def serialise_built(
    digest: bytes, make: Callable[[Block], int], space: BlockAllocator = HEAP_ALLOCATOR
) -> bytes:
    """Serialise an object that `make` creates in the block passed to it; `make` may raise HeapFull.

    The bytes of this block are from `space`, preferably the space of the source block.
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
            # Twice the missing words, since the object may consist of many small ones.
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
