"""What is done with whole heaps, in Python and in WebAssembly: collection, deep copy, check of an arrival.

Both work in this process on the same bytes, and leave the same bytes; each case is a heap that is full of
what is alive, small objects or one array, or a short string alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from harness.checkout import Checkout
from harness.figure import Figure
from harness.processes import Processes
from harness.samples import Contender, timed

from lfield.bytecode.program import ARRAY, INT
from lfield.testing.golden import compile_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.collector import collect
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import HEADER_WORDS, Layouts

PROGRAM = compile_text(
    """
    class Node { public int number; public Node next; }
    resource Holder { init(string[] arg) { Node n = null; int[] a = null; } }
    """
)
LAYOUTS = Layouts(PROGRAM)
NODE = PROGRAM.class_index["Node"]
TYPES = PROGRAM.core.types
INTS = next(i for i, t in enumerate(TYPES) if t.kind == ARRAY and TYPES[t.of].kind == INT)
#: The largest heap of an agent that nothing is said of, in bytes, and a tenth of it.
SIZES = {"1 MiB": 1 << 20, "0.1 MiB": (1 << 20) // 80 * 8}


def objects(block: Block) -> int:
    """A list of nodes of three words until nothing more fits; its first one."""
    first = 0
    while block.top + 3 <= block.end:
        node = block.allocate(layout.OBJECT, NODE, 3)
        block.w[node + 1], block.w[node + 2] = node, first
        first = node
    return first


def array(block: Block) -> int:
    """One array of ints, as large as there is room."""
    return block.allocate(layout.ARRAY, INTS, block.end - block.top)


def filled(space: BlockAllocator, size: int, fill: Callable[[Block], int]) -> Block:
    """A heap of so many bytes, full of what is alive."""
    block = Block.empty(PROGRAM.digest, size // 8, space)
    collect(block, LAYOUTS, size // 8)
    block.w[layout.W_SELF] = fill(block)
    return block


def string(block: Block) -> int:
    """A name."""
    return block.new_string("copter 1")


def cases(space: BlockAllocator) -> Iterator[tuple[str, Callable[[], object]]]:
    """What is measured, by name."""
    sound = BlockVerifier(PROGRAM, LAYOUTS, (), space)
    heaps = [(said, size, fill) for said, size in SIZES.items() for fill in (objects, array)]
    for said, size, fill in (*heaps, ("alone", 1 << 12, string)):
        block, target = filled(space, size, fill), filled(space, 1 << 21, string)
        image = bytes(block.image())
        what = fill.__name__
        yield f"{said}: collection, {what}", lambda block=block: collect(block, LAYOUTS)
        yield f"{said}: deep copy, {what}", lambda pair=(block, target): copied(*pair)
        yield f"{said}: check, {what}", lambda image=image: checked(sound, image)


def copied(source: Block, target: Block) -> None:
    """A deep copy of all that is alive."""
    target.top = HEADER_WORDS
    deep_copy(source, [source.w[layout.W_SELF]], target, LAYOUTS)


def checked(sound: BlockVerifier, image: bytes) -> None:
    """What comes from a peer is copied and walked through; it is whole."""
    assert sound.is_result(image, thrown=False)


def in_python(checkout: Checkout, processes: Processes) -> Contender:
    """Blocks with bytes of their own."""
    return in_space(HEAP_ALLOCATOR)


def in_wasm(checkout: Checkout, processes: Processes) -> Contender:
    """Blocks in an arena."""
    from lfield.vm.wasm.heap_arena import HeapArena

    return in_space(HeapArena())


def in_space(space: BlockAllocator) -> Contender:
    """All cases in one space; a sample is the mean of a few milliseconds."""
    made = dict(cases(space))
    return lambda: {name: [timed(work, 5e-3)] for name, work in made.items()}


FIGURE = Figure(
    "Work on whole heaps, in Python and in WebAssembly; ratio to Python",
    {"Python": in_python, "WebAssembly": in_wasm},
    base=("Python",),
    rounds=9,
    sizes=SIZES,
    targets={"1 MiB: collection, objects": "1 ms"},
)
