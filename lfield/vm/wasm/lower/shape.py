"""Control as WebAssembly has it, `block` and `loop`, from a graph (Ramsey, *Beyond Relooper*, 2022).

What a node dominates is written behind it: in place where only one way leads there, else behind the `end` of
a block around the node, so that every way there is a `br` out of that block. The header of a loop is written
inside a `loop`, and the ways back are `br`s to it.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.wasm.lower.flow import dominators, predecessors, reverse_postorder

Successors = Callable[[int], list[int]]
#: A line of text, or a node that is written in place.
Item = str | int
#: The way to another node.
Go = Callable[[int], list[Item]]
#: Writes a node; every way out of it is a `Go`, or leaves the function.
Write = Callable[[int, Go], list[Item]]


class Shape:
    """A graph from its root on; the nodes in `labelled` are gone to by `br_table`."""

    def __init__(self, root: int, leads_to: Successors, labelled: set[int]) -> None:
        self.root = root
        order = reverse_postorder(root, leads_to)
        self._place = {node: i for i, node in enumerate(order)}
        before = predecessors(order, leads_to)
        above = dominators(order, before)
        self._headers = {n for n in order if any(self._back(b, n) for b in before[n])}
        joins = {n for n in order if sum(not self._back(b, n) for b in before[n]) > 1}
        self._joins = (joins | labelled) - {root}
        self._below: dict[int, list[int]] = {node: [] for node in order}
        for node in order[1:]:
            if node in self._joins:
                self._below[above[node]].append(node)

    def _back(self, of: int, to: int) -> bool:
        return self._place[of] >= self._place[to]

    def label(self, of: int, to: int) -> str:
        """The label by which a node is gone to from another one."""
        return f"$l{to}" if self._back(of, to) else f"$b{to}"

    def lines(self, write: Write) -> list[str]:
        """The text of all nodes."""
        done: list[str] = []
        pending: list[Item] = [self.root]
        while pending:
            item = pending.pop()
            if isinstance(item, str):
                done.append(item)
            else:
                pending += reversed(self._tree(item, write))
        return done

    def _tree(self, node: int, write: Write) -> list[Item]:
        """A node and what is joined below it."""
        below = self._below[node]
        items: list[Item] = [f"block $b{n}" for n in reversed(below)]
        items += write(node, lambda to: self._go(node, to))
        for n in below:
            items += ["end", n]
        if node in self._headers:
            items = [f"loop $l{node}", *items, "end", "unreachable"]
        return items

    def _go(self, of: int, to: int) -> list[Item]:
        if to in self._joins or self._back(of, to):
            return [f"br {self.label(of, to)}"]
        return [to]
