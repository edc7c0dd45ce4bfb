"""Deep copy between blocks for portal calls: aliases and cycles are preserved (chapter IV)."""

from __future__ import annotations

from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.layout import Layouts


def deep_copy(source: Block, roots: list[int], target: Block, layouts: Layouts) -> list[int]:
    """Copy all objects reachable from `roots`, except uncopied references; returns the copied references.

    One call preserves aliases among all its roots. Raises HeapFull with the words needed, before any write.
    Other words are copied unchanged, so both blocks must be of the same program.
    """
    if not any(roots):
        target.require(0)
        return list(roots)
    native_result = target.space.copy(
        source.data, source.top, roots, target.data, target.top, target.end, layouts
    )
    if native_result is not None:
        copies, top = native_result
        if top < 0:
            raise HeapFull(-top)
        target.set_top(top)
        return copies
    order, words = _closure(source, roots, layouts)
    target.require(words)
    w, into = source.w, target.w
    moved = {0: 0}
    place = target.top
    for old in order:
        size = w[old] >> 32
        into[place : place + size] = w[old : old + size]
        moved[old] = place
        place += size
    for old in order:
        new, uncopied = moved[old], _uncopied_offset(layouts, w[old])
        for offset in layouts.references(w[old]):
            into[new + offset] = 0 if offset == uncopied else moved[w[old + offset]]
    target.set_top(place)
    return [moved[root] for root in roots]


def _closure(source: Block, roots: list[int], layouts: Layouts) -> tuple[list[int], int]:
    """All reachable objects, in order of discovery, and their size in words."""
    w = source.w
    visited: set[int] = {0}
    order: list[int] = []
    words = 0
    pending = list(roots)
    while pending:
        place = pending.pop()
        if place in visited:
            continue
        visited.add(place)
        order.append(place)
        head = w[place]
        words += head >> 32
        uncopied = _uncopied_offset(layouts, head)
        pending.extend(w[place + offset] for offset in layouts.references(head) if offset != uncopied)
    return order, words


def _uncopied_offset(layouts: Layouts, head: int) -> int:
    """The offset of the reference that is not followed, 0 for none."""
    return layouts.uncopied.get(head & 0xFFFFFFFF, 0)
