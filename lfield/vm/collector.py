"""The collector: copies what is alive to a new run of bytes, so that a hop costs live data only.

Cheney's algorithm: the new space is its own work list. Records tell where references are; nothing else is
ever mistaken for one. The cost grows with live data, never with garbage.
"""

from __future__ import annotations

from lfield.vm.block import INITIAL_WORDS, RESERVE_WORDS, Block
from lfield.vm.layout import HEADER_WORDS, ROOTS, Layouts


def collect(block: Block, layouts: Layouts, room: int = 0) -> None:
    """Compact the block and leave at least `room` words free if its limit (and reserve) allows.

    Every reference that lies outside the block (a thread's place, say) is wrong afterwards.
    """
    old = block.w
    data = bytearray(8 * block.top)
    new = memoryview(data).cast("q")
    new[:HEADER_WORDS] = old[:HEADER_WORDS]
    top = HEADER_WORDS
    for root in ROOTS:
        top = _forward(old, new, root, top)
    scan = HEADER_WORDS
    references = layouts.references
    while scan < top:
        head = new[scan]
        for offset in references(head):
            if new[scan + offset]:
                top = _forward(old, new, scan + offset, top)
        scan += head >> 32
    new.release()
    _fit(block, data, top, room)


def _forward(old: memoryview[int], new: memoryview[int], word: int, top: int) -> int:
    """Let the reference at `word` lead to the new place of its target; returns the new top."""
    target = new[word]
    if not target:
        return top
    head = old[target]
    if head < 0:
        new[word] = -head
        return top
    words = head >> 32
    new[top : top + words] = old[target : target + words]
    old[target] = -top
    new[word] = top
    return top + words


def _fit(block: Block, data: bytearray, top: int, room: int) -> None:
    """Give the block bytes for twice what lives, within its limit."""
    wanted = max(INITIAL_WORDS, 2 * top + room)
    most = block.limit if top + room <= block.limit else block.limit + RESERVE_WORDS
    words = max(top, min(wanted, most))
    if 8 * words > len(data):
        data.extend(bytes(8 * words - len(data)))
    else:
        del data[8 * words :]
    block.replace(data, top)
