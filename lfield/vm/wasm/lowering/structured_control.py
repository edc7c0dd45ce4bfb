"""Structured control (`block`, `loop`) from a control-flow graph (Ramsey, *Beyond Relooper*, 2022).

Dominated nodes are written after their dominator: in place if they have one predecessor, else after the
`end` of a block around it, so that every edge is a `br` out of that block. A loop header is written inside a
`loop`, and back edges are `br`s to it.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.wasm.lowering.dominators import immediate_dominators, predecessors, reverse_postorder

Successors = Callable[[int], list[int]]
#: A line of text, or a node that is written in place.
Item = str | int
#: The edge to another node.
Go = Callable[[int], list[Item]]
#: Writes a node; every edge out of it is a `Go`, or leaves the function.
Write = Callable[[int, Go], list[Item]]


class StructuredControl:
    """A graph from its root on; nodes in `labelled` are targets of `br_table`."""

    def __init__(self, root: int, leads_to: Successors, labelled: set[int]) -> None:
        self.root = root
        order = reverse_postorder(root, leads_to)
        self._place = {node: i for i, node in enumerate(order)}
        before = predecessors(order, leads_to)
        above = immediate_dominators(order, before)
        self._headers = {n for n in order if any(self._back(b, n) for b in before[n])}
        joins = {n for n in order if sum(not self._back(b, n) for b in before[n]) > 1}
        self._joins = (joins | labelled) - {root}
        self._below: dict[int, list[int]] = {node: [] for node in order}
        for node in order[1:]:
            if node in self._joins:
                self._below[above[node]].append(node)

    def _back(self, source: int, target: int) -> bool:
        return self._place[source] >= self._place[target]

    def label(self, source: int, target: int) -> str:
        """The label of a node for a branch from another one."""
        return f"$l{target}" if self._back(source, target) else f"$b{target}"

    def lines(self, write: Write) -> list[str]:
        """The text of all nodes."""
        lines: list[str] = []
        pending: list[Item] = [self.root]
        while pending:
            item = pending.pop()
            if isinstance(item, str):
                lines.append(item)
            else:
                pending += reversed(self._tree(item, write))
        return lines

    def _tree(self, node: int, write: Write) -> list[Item]:
        """A node and the nodes merged below it."""
        below = self._below[node]
        items: list[Item] = [f"block $b{n}" for n in reversed(below)]
        items += write(node, lambda target: self._go(node, target))
        for n in below:
            items += ["end", n]
        if node in self._headers:
            items = [f"loop $l{node}", *items, "end", "unreachable"]
        return items

    def _go(self, source: int, target: int) -> list[Item]:
        if target in self._joins or self._back(source, target):
            return [f"br {self.label(source, target)}"]
        return [target]
