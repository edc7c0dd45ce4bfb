"""Deep copy between blocks: what crosses a portal is copied whole, aliases and cycles kept (chapter IV)."""

from __future__ import annotations

from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.layout import Layouts


def deep_copy(source: Block, roots: list[int], target: Block, layouts: Layouts) -> list[int]:
    """Copy everything the references in `roots` lead to, but for what stays; returns the references there.

    One call keeps aliases among all its roots. Raises Full, with the words it needs, before it writes
    anything. The words around the references are copied as they are, so both blocks must be of the same
    program.
    """
    if not any(roots):
        target.require(0)
        return list(roots)
    done = target.space.copied(source.data, source.top, roots, target.data, target.top, target.end, layouts)
    if done is not None:
        copies, top = done
        if top < 0:
            raise Full(-top)
        target.top = top
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
        new, stays = moved[old], _staying(layouts, w[old])
        for offset in layouts.references(w[old]):
            into[new + offset] = 0 if offset == stays else moved[w[old + offset]]
    target.top = place
    return [moved[root] for root in roots]


def _closure(source: Block, roots: list[int], layouts: Layouts) -> tuple[list[int], int]:
    """Everything reachable, in the order found, and its size in words."""
    w = source.w
    seen: set[int] = {0}
    order: list[int] = []
    words = 0
    pending = list(roots)
    while pending:
        place = pending.pop()
        if place in seen:
            continue
        seen.add(place)
        order.append(place)
        head = w[place]
        words += head >> 32
        stays = _staying(layouts, head)
        pending.extend(w[place + offset] for offset in layouts.references(head) if offset != stays)
    return order, words


def _staying(layouts: Layouts, head: int) -> int:
    """The offset of the reference that is not followed, 0 for none."""
    return layouts.stays.get(head & 0xFFFFFFFF, 0)
