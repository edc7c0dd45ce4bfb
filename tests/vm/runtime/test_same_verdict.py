"""Images from peers, valid and damaged: WebAssembly and Python give the same verdict and error."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

pytest.importorskip("wasmtime", reason="the engine in WebAssembly needs wasmtime: pip install lfield[wasm]")

from random_heaps import LIMIT, MEMBERS, RandomHeap, heaps

from lfield.bytecode.program import NULL, OBJECT, Program, TypeRecord
from lfield.clock import ManualClock
from lfield.errors import BlockError
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.layout import Layouts

seeds = st.integers(0, 1 << 32)

TRAVELLER = compile_text(
    """
    class Note {
        public int number; public string text; public Note next; public real[] more; public Note[] all;
        public Note(int n, Note rest) {
            number = n; text = "é" + i2s(n); next = rest;
            all = new Note[2]; all[1] = rest;
        }
    }
    resource Post { init(string[] arg) { while (true) yield(); } portal leave(Note n) { } }
    coordinator Boss {
        init(string[] arg) {
            Note n = null;
            for (int i = 0; i < 5; i = i + 1) n = new Note(i, n);
            Post[] all = findPost();
            reserve (all) { work(all[1], n); }
        }
        private void work(Post p, Note n) { p.leave(n); }
    }
    coordinator Chief {
        init(string[] arg) {
            Post[] all = findPost();
            together { all[1].leave(new Note(1, null)); all[1].leave(null); all[0].leave(null); }
        }
    }
    coordinator Walker {
        init(string[] arg) { deeper(new Note(1, null), 3); }
        private synchronized int deeper(Note n, int left) {
            Post[] all = findPost();
            if (left > 0) return 1 + deeper(new Note(left, n), left - 1);
            all[1].leave(n);
            return left;
        }
    }
    """
)
TEAM = [
    TeamMember(0, "here", "Post", "resource", 0),
    TeamMember(1, "there", "Post", "resource", 1),
    TeamMember(2, "boss", "Boss", "coordinator", 0),
    TeamMember(3, "chief", "Chief", "coordinator", 0),
    TeamMember(4, "walker", "Walker", "coordinator", 0),
]


def packed() -> list[bytes]:
    """The images of coordinators that are about to migrate, one with calls of a `together`."""
    desk, clock = GoldenWorld(), ManualClock()
    machine = desk.machine = Machine(TRAVELLER, MachineTeam(TEAM, 0, 1), desk, clock, random.Random(1))
    for member in (TEAM[0], *TEAM[2:]):
        machine.start(member, AgentLimits(), generation=1)
    run_until_idle(machine, clock)
    return [bytes(machine.pack(agent)) for agent, _ in desk.departures]


IMAGES = packed()
#: The image of a coordinator without reservations and calls: WebAssembly verifies it alone.
WALKER = IMAGES[-1]
IMAGE = max(IMAGES[:2], key=len)


def checkers(program: Program, members: tuple[str, ...]) -> list[BlockVerifier]:
    layouts = Layouts(program)
    return [BlockVerifier(program, layouts, members, space) for space in (HEAP_ALLOCATOR, heaps())]


CHECKERS = checkers(TRAVELLER, tuple(member.type for member in TEAM))


def error_of(check: Callable[[], object]) -> str:
    """The error of a check, or ''."""
    try:
        check()
    except BlockError as error:
        return str(error)
    return ""


def damaged(image: bytes, rng: random.Random) -> bytes:
    """Change a few words: to any value, to each other, or by a bit."""
    data = bytearray(image)
    w = memoryview(data).cast("q")
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        at, other = rng.randrange(len(w)), rng.randrange(len(w))
        match rng.randrange(6):
            case 0:
                w[at] = rng.choice([0, 1, -1, -(1 << 63), (1 << 63) - 1, len(w), len(w) - 1, 1 << 32])
            case 1:
                w[at] = w[other]
            case 2:
                w[at] ^= 1 << rng.randrange(63)
            case 3:
                w[at] = rng.randrange(len(w))
            case 4:
                data[8 * at + rng.randrange(8)] = rng.choice(
                    b"\x00\x41\x80\xbf\xc0\xc1\xc2\xe0\xed\xf0\xf4\xf5"
                )
            case _:
                w[at] = w[at] + rng.choice([-1, 1]) * (1 << rng.choice([0, 8, 32])) & (1 << 62) - 1
    w[layout.W_TOP] = len(w)
    return bytes(data)


@pytest.mark.parametrize("image", IMAGES)
def test_a_valid_image_is_verified_without_the_walk_in_python(
    image: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = [checker.check(image, LIMIT) for checker in CHECKERS]
    assert len({bytes(block.image()) for block in blocks}) == 1
    assert len({block.end for block in blocks}) == 1
    assert heaps().base(blocks[1].data) >= 0
    for name in ("_walk", "_check_references"):
        monkeypatch.delattr(BlockVerifier, name)
    assert CHECKERS[1].check(image, LIMIT).top == blocks[0].top


def test_one_image_has_tickets() -> None:
    counts = []
    for image in IMAGES:
        block = CHECKERS[1].check(image, LIMIT)
        verified = heaps().verify_heap(block.data, block.heap, block.top, CHECKERS[1].schema)
        assert verified is not None
        counts.append(len(verified[1]))
    # Three calls, and their list.
    assert sorted(counts) == [0, 0, 4]


def test_an_image_without_calls_is_verified_without_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(BlockVerifier, "_adopt")
    assert bytes(CHECKERS[1].check(WALKER, LIMIT).image()) == WALKER
    for other in IMAGES[:2]:
        with pytest.raises(AttributeError):
            CHECKERS[1].check(other, LIMIT)


@settings(max_examples=400)
@given(seeds)
def test_a_damaged_walker_gives_the_same_error(seed: int) -> None:
    image = damaged(WALKER, random.Random(seed))
    first, second = (error_of(lambda c=checker: c.check(image, LIMIT)) for checker in CHECKERS)
    assert first == second


def test_any_changed_word_of_a_walker_gives_the_same_verdict() -> None:
    """Each word of its header, its thread and its frames, with each of these values."""
    words = memoryview(WALKER).cast("q")
    for at in range(len(words)):
        for other in (0, 1, -1, words[at] + 1, words[at] - 1, 1 << 62, len(words)):
            image = bytearray(WALKER)
            memoryview(image).cast("q")[at] = max(-(1 << 63), min(other, (1 << 63) - 1))
            first, second = (error_of(lambda c=c, i=image: c.check(i, LIMIT)) for c in CHECKERS)
            assert first == second, (at, other)


@given(st.sampled_from(IMAGES), seeds)
def test_a_damaged_coordinator_gives_the_same_error(sound: bytes, seed: int) -> None:
    image = damaged(sound, random.Random(seed))
    first, second = (error_of(lambda c=checker: c.check(image, LIMIT)) for checker in CHECKERS)
    assert first == second


def test_a_slot_of_type_null_must_hold_null() -> None:
    core, block = TRAVELLER.core, CHECKERS[0].check(IMAGE, LIMIT)
    frame = block.w[block.w[layout.W_THREADS] + layout.THREAD_FRAME]
    index = block.w[frame] >> 8 & 0xFFFFFF
    method = core.methods[index]
    note = TRAVELLER.class_index["Note"]
    slot = next(i for i, t in enumerate(method.slots) if core.types[t] == TypeRecord(OBJECT, note))
    slots = (*method.slots[:slot], NULL, *method.slots[slot + 1 :])
    methods = list(core.methods)
    methods[index] = replace(method, slots=slots)
    program = Program(replace(core, methods=tuple(methods)), TRAVELLER.debug, TRAVELLER.digest)
    block.w[frame + layout.FRAME_SLOTS + slot] = frame + 1
    for checker in checkers(program, tuple(member.type for member in TEAM)):
        with pytest.raises(BlockError, match="a reference does not refer to an object of its type"):
            checker.check(block.image(), LIMIT)


def test_most_damages_are_detected() -> None:
    """Shows that the property above has cases to check."""
    verdicts = [
        error_of(lambda i=i: CHECKERS[1].check(damaged(IMAGE, random.Random(i)), LIMIT)) for i in range(400)
    ]
    assert 40 < verdicts.count("") < 360
    assert len(set(verdicts)) > 60


#: Errors of objects on the heap.
OF_THINGS = (
    "an object on the heap",
    "a string is not",
    "a proxy does not refer",
    "a reference does not refer",
    "is one of its calls",
    "an array is longer than its elements",
)
#: Errors of tickets, which only Python checks; objects behind the ticket may be damaged as well.
OF_TICKETS = ("ticket", "a together")
#: Errors of headers, which are checked before the heap.
OF_HEADERS = ("magic", "another program", "its size", "heartbeat", "its clock", "its counters")


@given(seeds, st.booleans())
def test_random_heaps_valid_or_not_give_the_same_verdict(seed: int, tickets: bool) -> None:
    """Without errors of objects, Python is not asked about them; it checks tickets."""
    heap = RandomHeap(seed, tickets=tickets)
    rng = random.Random(seed)
    image = bytes(heap.block.image())
    if rng.random() < 0.8:
        image = damaged(image, rng)
    first, second = (
        error_of(lambda c=checker: c.check(image, LIMIT)) for checker in checkers(heap.program, MEMBERS)
    )
    assert first == second
    space = heaps()
    data = space.allocate(len(image))
    data[:] = image
    w = memoryview(data).cast("q")
    top, heap_at = len(w), layout.HEADER_WORDS
    verified = space.verify_heap(data, heap_at, top, heap.shapes)
    if w[layout.W_MAGIC] != layout.MAGIC | layout.VERSION << 32:
        return
    if any(what in first for what in OF_THINGS):
        assert verified is None
    elif not any(what in first for what in (*OF_HEADERS, *OF_TICKETS)):
        assert verified is not None
    if verified is None:
        return
    starts, places = verified
    place, found = heap_at, {}
    while place < top:
        found[place] = w[place] & 0xFFFFFFFF
        place += w[place] >> 32
    assert dict(starts) == found
    assert places == [place for place, half in found.items() if half & 0xFF == layout.TICKET]


@given(st.binary(max_size=24), st.integers(-1, 30), st.integers(0, 4))
def test_valid_texts_are_the_same(raw: bytes, length: int, words: int) -> None:
    """UTF-8 in its shortest form, without surrogates; the length must be within the string."""
    body = raw + bytes(-len(raw) % 8 + 8 * words)
    size = 2 + len(body) // 8
    thing = (
        (layout.STRING | size << 32).to_bytes(8, "little") + length.to_bytes(8, "little", signed=True) + body
    )
    image = bytearray(IMAGE + thing)
    memoryview(image).cast("q")[layout.W_TOP] = len(image) // 8
    first, second = (error_of(lambda c=checker: c.check(image, LIMIT)) for checker in CHECKERS)
    assert first == second
    text = body[: max(length, 0)]
    try:
        text.decode()
        sound = 0 <= length <= len(body)
    except UnicodeDecodeError:
        sound = False
    assert (first == "") == sound


@pytest.mark.few(8)
@pytest.mark.parametrize("lead", range(0x80, 0x100))
def test_every_lead_and_second_byte_of_text_gives_the_same_verdict(lead: int) -> None:
    for second in range(0x100):
        for rest in (b"", b"\x80", b"\x80\xbf", b"\x41\x80"):
            test_valid_texts_are_the_same.hypothesis.inner_test(
                bytes([lead, second]) + rest, 2 + len(rest), 0
            )
