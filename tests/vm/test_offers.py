"""Offers in the block: written at once, ordinary objects from then on, an exception without space."""

from __future__ import annotations

import math
import random
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from joined_hosts import JoinedHosts

from lfield.bytecode.program import Program
from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.collector import collect
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import Layouts
from lfield.vm.offer_objects import (
    FoundOffer,
    OfferClasses,
    SearchIncomplete,
    UnknownRealisation,
    realisations,
    write_offers,
)

TEAM = """
resource Crane {
  init(string[] arg) { while (true) yield(); }
  portal lift(real height) emit real { print("crane " + f2s(height)); return height; }
  portal stop() { }
}
resource Copter {
  init(string[] arg) { while (true) yield(); }
  portal climb(real height) emit real { print("copter " + f2s(height)); return height; }
  portal stop() { }
}
resource Hand {
  init(string[] arg) { while (true) yield(); }
  portal grip() emit boolean { print("hand"); return true; }
}
"""
BOSS = "coordinator Boss { init(string[] arg) { Lift[] who = findLift(arg[1]); %s } }"


@cache
def registry() -> Registry:
    return read_registry([Path(__file__).parents[1] / "golden" / "programs" / "lifting.yaml"])


@cache
def program(body: str = "") -> Program:
    return compile_text(TEAM + BOSS % body, registry=registry())


def members(host: int = 0) -> list[TeamMember]:
    return [
        TeamMember(0, "crane", "Crane", "resource", host),
        TeamMember(1, "copter", "Copter", "resource", host),
        TeamMember(2, "hand", "Hand", "resource", host),
        TeamMember(3, "boss", "Boss", "coordinator", 0, ("any",)),
    ]


def direct(way: str, member: int, **facts: object) -> FoundOffer:
    return FoundOffer(way, f"agent{member}", "host", "direct", 0.5, member, **facts)


CLIMB, GRIP = direct("byCopter", 1), direct("byHand", 2)
PARTS = {"of_grip_and_climb_hand": GRIP, "of_grip_and_climb_sky": CLIMB}
WHOLE = FoundOffer("of_grip_and_climb", "hand+copter", "a+b", "composed: ...", 0.25, parts=PARTS)

_texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
_fact = st.tuples(
    _texts, st.floats(allow_nan=False), st.one_of(st.none(), _texts), st.floats(0, 1e6, allow_nan=False)
)


@st.composite
def offers(draw: st.DrawFn) -> FoundOffer:
    """An offer of Lift with any facts, by any realisation, and its parts with any."""
    facts = [tuple(column) for column in zip(*draw(st.lists(_fact, max_size=4)), strict=True)]
    names, numbers, texts, ages = facts or ((), (), (), ())
    offer_fields = {
        "agent": draw(_texts),
        "host": draw(_texts),
        "kind": draw(_texts),
        "score": draw(st.floats(0, 1)),
    }
    offer_fields |= {"names": names, "numbers": numbers, "texts": texts, "ages": ages}
    way = draw(st.sampled_from(["byCrane", "as_climb_lifts", "of_grip_and_climb"]))
    if way == "byCrane":
        return FoundOffer(way, member=draw(st.sampled_from([0, 3])), **offer_fields)
    parts = PARTS if way == "of_grip_and_climb" else {way: CLIMB}
    return FoundOffer(way, parts=parts, **offer_fields)


def new_block(limit: int = 1 << 17) -> Block:
    block = Block.empty(program().digest, limit)
    collect(block, Layouts(program()), min(limit, 1 << 15) - 512)
    return block


def read(block: Block, place: int, name: str = "Lift") -> FoundOffer:
    """An offer as it is stored in a block."""
    index = program().class_index[name]
    head = block.w[place]
    assert (head & 0xFF, head >> 8 & 0xFFFFFF) == (layout.OBJECT, index)
    fields = [f.name for f in program().core.classes[index].fields]
    filled = {field: block.w[place + 1 + i] for i, field in enumerate(fields) if block.w[place + 1 + i]}
    facts = filled.pop("facts")
    agent, host, kind = (block.text(block.w[facts + i]) for i in (1, 2, 3))
    names, texts = (strings(block, block.w[facts + i]) for i in (5, 7))
    numbers, ages = (reals(block, block.w[facts + i]) for i in (6, 8))
    offer_fields = (agent, host, kind, block.r[facts + 4])
    (way, target), *_ = filled.items()
    if block.w[target] & 0xFF == layout.PROXY:
        return FoundOffer(way, *offer_fields, block.w[target + 1], {}, names, numbers, texts, ages)
    kinds = {"as_climb_lifts": "Climb", "of_grip_and_climb_hand": "Grip", "of_grip_and_climb_sky": "Climb"}
    parts = {field: read(block, part, kinds[field]) for field, part in filled.items()}
    own = "of_grip_and_climb" if len(parts) > 1 else way
    return FoundOffer(own, *offer_fields, -1, parts, names, numbers, texts, ages)


def elements(block: Block, place: int) -> range:
    return range(place + 1, place + (block.w[place] >> 32))


def strings(block: Block, place: int) -> tuple[str | None, ...]:
    return tuple(block.string(block.w[i]) if block.w[i] else None for i in elements(block, place))


def reals(block: Block, place: int) -> tuple[float, ...]:
    return tuple(block.r[i] for i in elements(block, place))


def read_all(block: Block, array: int) -> list[FoundOffer]:
    return [read(block, block.w[i]) for i in elements(block, array)]


def written(block: Block, found: list[FoundOffer]) -> int:
    return write_offers(block, OfferClasses(program()), program().class_index["Lift"], found, 0.0)


@given(st.lists(offers(), max_size=6))
def test_offers_are_ordinary_objects(found: list[FoundOffer]) -> None:
    """Read back, verified like bytes from a peer, collected, and copied deeply."""
    layouts = Layouts(program())
    block, other = new_block(), new_block()
    array = written(block, found)
    assert read_all(block, array) == found
    (copy,) = deep_copy(block, [array], other, layouts)
    assert read_all(other, copy) == found
    block.w[layout.W_THREADS] = 0
    soundness = BlockVerifier(program(), Layouts(program()), ["Crane", "Copter", "Hand", "Crane"])
    block.w[layout.W_CLASS] = program().class_index["Boss"]
    soundness.check_heap(bytes(block.image()), 1 << 17)
    block.w[layout.W_ID] = array
    collect(block, layouts)
    assert read_all(block, block.w[layout.W_ID]) == found


def test_equal_words_are_written_once() -> None:
    few, many = new_block(), new_block()
    names, numbers, texts, ages = ("payload", "colour"), (1.0, math.nan), (None, "red"), (0.0, 0.0)
    one = FoundOffer("byCrane", "agent", "a host", "direct", 0.5, 0, {}, names, numbers, texts, ages)
    found = [one] * 100
    written(few, found[:1])
    written(many, found)
    words = {block.top - layout.HEADER_WORDS for block in (few, many)}
    # The object, its facts, its numbers, its proxy, and its place in the array.
    assert max(words) - min(words) == 99 * (7 + 13 + 3 + 3 + 1)


@pytest.mark.parametrize("agent", ["a", "a very long name " * 50])
def test_a_full_block_is_not_changed_and_the_needed_words_are_reported(agent: str) -> None:
    found = [WHOLE, *(FoundOffer("byCrane", f"{agent}{i}", "h", "direct", 0.5, 0) for i in range(100))]
    block = Block.empty(program().digest, 1 << 17)
    before = bytes(block.image())
    with pytest.raises(HeapFull) as full:
        written(block, found)
    assert bytes(block.image()) == before
    roomy = new_block()
    start = roomy.top
    written(roomy, found)
    assert full.value.words <= roomy.top - start
    exact = Block.empty(program().digest, 1 << 17)
    collect(exact, Layouts(program()), roomy.top - start)
    exact.end = exact.top + roomy.top - start
    written(exact, found)
    assert exact.top == exact.end


@pytest.mark.parametrize(
    "found",
    [
        direct("byWinch", 0),
        direct("facts", 0),
        direct("as_climb_lifts", 0),
        FoundOffer("byCrane", "a", "h", "equivalent", 0.5, parts={"byCrane": CLIMB}),
        FoundOffer("of_grip_and_climb", "a", "h", "composed", 0.5, parts={"of_grip_and_climb": GRIP}),
    ],
)
def test_an_unknown_realisation_is_refused(found: FoundOffer) -> None:
    with pytest.raises(UnknownRealisation, match="the program has no realisation"):
        written(new_block(), [found])


def test_a_program_has_the_realisations_of_its_registry() -> None:
    assert realisations(program()) == {
        "Lift": {
            "byCrane",
            "as_climb_lifts",
            "of_grip_and_climb",
            "of_grip_and_climb_hand",
            "of_grip_and_climb_sky",
        },
        "Climb": {"byCopter"},
        "Grip": {"byHand"},
    }


class Asked(GoldenWorld):
    """A world that always finds the same offers."""

    def __init__(self, found: list[FoundOffer]) -> None:
        super().__init__()
        self.found = found
        self.queries: list[tuple[str, str | None]] = []

    def offers(self, agent: object, capability: str, constraint: str | None) -> list[FoundOffer]:
        self.queries.append((capability, constraint))
        if constraint == "too much":
            raise SearchIncomplete("nobody was found, but there is more")
        return self.found


def run(body: str, found: list[FoundOffer], heap: int = 1 << 20) -> Asked:
    """The coordinator alone on a host with all resources."""
    desk, clock = Asked(found), ManualClock()
    machine = Machine(program(body), MachineTeam(members(), 0, 1), desk, clock, random.Random(1))
    for member in members():
        machine.start(member, AgentLimits(heap=heap), generation=1)
    run_until_idle(machine, clock)
    return desk


def test_a_query_is_made_once_despite_a_collection() -> None:
    body = "int[] garbage = new int[20000]; garbage = null; who = findLift(); print(who.length());"
    desk = run(body, [WHOLE] * 300, heap=1 << 19)
    assert desk.output == ["300"]
    assert desk.queries == [("Lift", "any"), ("Lift", None)]


@pytest.mark.few(0)
def test_more_offers_than_the_heap_holds_raise_an_exception() -> None:
    desk = run("print(who.length());", [WHOLE] * 5000, heap=1 << 17)
    (ended,) = (agent for agent in desk.endings if agent.ended == "died")
    assert ended.report.startswith("LimitException: the heap of boss is over its limit of 131072 bytes")


def test_an_incomplete_search_without_offers_raises_an_exception() -> None:
    body = 'try { who = findLift("too " + "much"); } catch (LimitException e) { print(e.message()); }'
    assert run(body, []).output == ["nobody was found, but there is more"]


def test_offers_of_an_unknown_realisation_raise_a_catchable_exception() -> None:
    body = "try { who = findLift(); } catch (ConstraintException e) { print(e.message()); }"
    desk, clock = Asked([]), ManualClock()
    machine = Machine(program(body), MachineTeam(members(), 0, 1), desk, clock, random.Random(1))
    for member in members():
        machine.start(member, AgentLimits(), generation=1)
    desk.offers = lambda *asked: [] if asked[2] else [direct("byWinch", 0)]  # type: ignore[method-assign]  # one answer
    run_until_idle(machine, clock)
    assert desk.output == [
        "the program has no realisation 'byWinch' of Lift: build it again with the registry that the hosts "
        "have"
    ]


def test_offers_migrate_with_the_coordinator_and_can_be_called() -> None:
    """Two machines as two hosts: every call of an offer moves the coordinator, for all parts."""
    body = (
        "for (int i = 0; i < who.length(); i = i + 1) { who[i].lift(i + 1.0); who[i].lift(0.5); }"
        'print(who[2].agent() + who[2].way() + f2s(who[1].attribute("payload")) + i2s(hops()));'
    )
    facts = {"names": ("payload",), "numbers": (2.5,), "texts": (None,), "ages": (0.0,)}
    equivalent = FoundOffer(
        "as_climb_lifts", "copter", "b", "equivalent", 0.5, -1, {"as_climb_lifts": CLIMB}, **facts
    )
    desks = [Asked([direct("byCrane", 0), equivalent, WHOLE]), Asked([])]
    JoinedHosts(program(body), members(1), place=iter(desks).__next__).run()
    assert desks[1].output == [
        "crane 1.0", "crane 0.5", "copter 2.0", "copter 0.5", "hand", "copter 3.0", "hand", "copter 0.5",
        "hand+coptercomposed: ...2.51",
    ]  # fmt: skip
    assert [agent.ended for agent in desks[1].endings] == ["done"]
