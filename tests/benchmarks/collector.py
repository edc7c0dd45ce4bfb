"""How long the collector stops an agent, by what lives on its heap: many small objects, or one big array.

The pause is one call of the collector on an agent's block; it grows with live data only. For scale, a plain
copy of the same bytes: what no copying collector can beat.
"""

from __future__ import annotations

from functools import partial

from harness import Figure, Row, in_turns, median, microseconds, percentile, play, size, stage, timed, times

from lfield.testing.golden import compile_text
from lfield.vm.memory.block import Block
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import Layouts

SIZES = (1 << 10, 16 << 10, 128 << 10, 1 << 20)
ROUNDS = 40

#: Bytes of a Node on the heap: header, number, next.
_NODE = 24

_PROGRAM = """
class Node {
    public int number;
    public Node next;
    public Node(int n, Node rest) { number = n; next = rest; }
}

resource Holder {
    Node first;
    int[] numbers;

    init(string[] arg) {
        for (int i = 0; i < %(nodes)d; i = i + 1) first = new Node(i, first);
        numbers = new int[%(numbers)d];
        while (true) yield();
    }
}
"""


def figure() -> Figure:
    """All sizes."""
    rows = [row for count in SIZES for row in _rows(count)]
    return Figure("Pause of the collector by live heap; ratio to a plain copy", rows, (f"{ROUNDS} rounds",))


def _rows(count: int) -> list[Row]:
    objects, layouts = _block(nodes=count // _NODE)
    array, array_layouts = _block(numbers=count // 8)
    samples = in_turns(
        {
            f"{count // _NODE} objects": partial(_pause, objects, layouts),
            "one array": partial(_pause, array, array_layouts),
            "plain copy": partial(_copy, array),
        },
        ROUNDS,
    )
    plain = median(samples["plain copy"])
    return [
        Row(
            size(count) if i == 0 else "",
            name,
            microseconds(median(own)),
            microseconds(percentile(own, 99)),
            times(median(own) / plain),
        )
        for i, (name, own) in enumerate(samples.items())
    ]


def _block(nodes: int = 0, numbers: int = 0) -> tuple[Block, Layouts]:
    """The block of a resource that holds so much, compacted."""
    machine, desk = stage(compile_text(_PROGRAM % {"nodes": nodes, "numbers": numbers}))
    play(machine, desk)
    block = machine.agents["holder"].block
    collect(block, machine.layouts)
    return block, machine.layouts


def _pause(block: Block, layouts: Layouts) -> list[float]:
    return [timed(partial(collect, block, layouts))]


def _copy(block: Block) -> list[float]:
    image = block.image()
    return [timed(partial(bytearray, image))]
