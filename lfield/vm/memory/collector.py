"""The collector: copies what is alive to a new run of bytes, so that a hop costs live data only.

Cheney's algorithm: the new space is its own work list. Records tell where references are; nothing else is
ever mistaken for one. The cost grows with live data, never with garbage.
"""

from __future__ import annotations

from lfield.vm.memory.block import INITIAL_WORDS, RESERVE_WORDS, Block
from lfield.vm.memory.layout import HEADER_WORDS, MAGIC, ROOTS, VERSION, W_MAGIC, Layouts
from lfield.vm.memory.space import Buffer

_NEW_WORDS = memoryview(bytes(8 * HEADER_WORDS)).cast("q")

#: Up to so many words a block grows only because it is filled often: 128 KiB.
GENEROUS = 1 << 14
#: Up to so many words a block is one packet on most networks, 1 KiB: a little less makes no difference.
PACKET = 1 << 7
#: So many bytes more than it needs a block that travels may keep: to move it costs more.
SPARE = 1 << 12


def collect(block: Block, layouts: Layouts, room: int = 0) -> None:
    """Compact the block and leave at least `room` words free if its limit (and reserve) allows.

    Whoever fills a small block again and again gets a larger one, up to GENEROUS, so that collections cost
    little beside the work that makes the garbage. Every reference that lies outside the block (a thread's
    place, say) is wrong afterwards.
    """
    size = len(block.w)
    # It is seldom of another size afterwards.
    data, top = _compact(block, layouts, 8 * size)
    wanted = max(INITIAL_WORDS, min(2 * size, GENEROUS), 2 * (top + room))
    most = block.limit if top + room <= block.limit else block.limit + RESERVE_WORDS
    words = max(top, min(wanted, most))
    block.replace(block.space.sized(data, 8 * words), top)
    block.packed = top


def compact(block: Block, layouts: Layouts) -> None:
    """Compact the block and leave little room or none: it is about to travel.

    Not when it is one packet and no larger than when it had no garbage: most visits leave nothing behind.
    """
    if block.packed == block.top <= PACKET:
        return
    data, top = _compact(block, layouts)
    block.replace(data if len(data) <= 8 * top + SPARE else block.space.sized(data, 8 * top), top)
    block.packed = top


def _compact(block: Block, layouts: Layouts, least: int = 0) -> tuple[Buffer, int]:
    """A copy of the block with only what is alive, and its top. Spoils the block's own bytes.

    It has room for `least` bytes. It has the header of this version: what is new in it is 0.
    """
    old = block.w
    data = block.space.room(max(least, 8 * (block.top + HEADER_WORDS - block.heap)))
    new = memoryview(data).cast("q")
    new[: block.heap] = old[: block.heap]
    new[block.heap : HEADER_WORDS] = _NEW_WORDS[block.heap :]
    new[W_MAGIC] = MAGIC | VERSION << 32
    top = block.space.collected(block.data, data, layouts)
    if not top:
        top = _copy(old, new, layouts)
    new.release()
    return data, top


def _copy(old: memoryview[int], new: memoryview[int], layouts: Layouts) -> int:
    """Copy what is alive behind the header that is in the new words; returns their top."""
    top = HEADER_WORDS
    scan = 0
    references: tuple[int, ...] | range = ROOTS
    # The header is scanned like the first thing on the heap, with the roots as its references.
    words = HEADER_WORDS
    while True:
        for offset in references:
            place = new[scan + offset]
            if not place:
                continue
            head = old[place]
            if head < 0:
                new[scan + offset] = -head
                continue
            size = head >> 32
            new[top : top + size] = old[place : place + size]
            old[place] = -top
            new[scan + offset] = top
            top += size
        scan += words
        if scan >= top:
            break
        head = new[scan]
        words = head >> 32
        references = layouts.references(head)
    return top
