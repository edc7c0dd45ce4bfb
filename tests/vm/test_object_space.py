"""Space for many small objects: the number of collections, and of moved words.

The tests count work, never time: for ten times as many objects, about ten times as much.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from lfield.bytecode.program import Program
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm import scheduler
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory.block import Block
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import HEADER_WORDS, Layouts
from lfield.vm.memory.serialised_results import serialise_built

#: For ten times as many objects, at most so many times as many words are moved.
GROWTH = 15
FEW, MANY = 400, 4000

TEXT = """
class Node { public Node next; public int number; public Node(Node n, int i) { next = n; number = i; } }
resource Post {
    init(string[] arg) { while (true) yield(); }
    portal take(Node first) { }
    portal give(int count) emit Node {
        Node n = null;
        for (int i = 0; i < count; i = i + 1) n = new Node(n, i);
        return n;
    }
}
coordinator Boss { init(string[] arg) { work(s2i(arg[1])); } private void work(int count) { %s } }
"""


@dataclass
class Work:
    """The work of the collector: the number of collections, and of moved words."""

    collections: int = 0
    words: int = 0


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Work:
    """Counts the collections that make space."""
    done = Work()

    def counted(block: Block, layouts: Layouts, room: int = 0) -> None:
        collect(block, layouts, room)
        done.collections += 1
        done.words += block.top
        assert done.collections < 20_000, "the machine collects without end"

    monkeypatch.setattr(scheduler, "collect", counted)
    return done


def run(
    body: str, count: int, posts: int = 1, limits: AgentLimits | None = None, arguments: int = 0
) -> GoldenWorld:
    """A boss that works with a number of posts."""
    program: Program = compile_text(TEXT % body)
    team = [TeamMember(i, f"post{i}", "Post", "resource", 0) for i in range(posts)]
    team.append(TeamMember(posts, "boss", "Boss", "coordinator", 0, (str(count), *["word"] * arguments)))
    desk, clock = GoldenWorld(), ManualClock()
    machine = desk.machine = Machine(program, MachineTeam(team, 0, 1), desk, clock, random.Random(1))
    for member in (team[0], team[-1]):
        machine.start(member, limits or AgentLimits(heap=1 << 22), generation=1)
    run_until_idle(machine, clock)
    return desk


def found(count: int) -> GoldenWorld:
    return run("print(findPost().length());", count, posts=count)


def create_objects(count: int) -> GoldenWorld:
    return run('print("born");', count, arguments=count)


def test_space_for_all_proxies_is_made_at_once(work: Work) -> None:
    assert found(MANY).output == [str(MANY)]
    assert work.collections == 1


@pytest.mark.parametrize("things", [found, create_objects])
def test_the_work_of_collections_is_linear_in_the_objects(
    things: Callable[[int], GoldenWorld], work: Work
) -> None:
    assert things(FEW).output
    few, work.words, work.collections = work.words, 0, 0
    assert things(MANY).output
    assert work.words < GROWTH * max(few, FEW)
    assert work.collections < 15


def test_a_parcel_of_many_small_objects_is_made_in_few_attempts() -> None:
    attempts = []

    def make(block: Block) -> int:
        attempts.append(block)
        return [block.new_string("word") for _ in range(MANY)][-1]

    parcel = serialise_built(bytes(32), make)
    assert len(parcel) == 8 * (HEADER_WORDS + 3 * MANY)
    assert len(attempts) < 15


COPIES = 'Post p = findPost("post0"); p.take(p.give(count)); print("copied");'


def test_space_for_a_deep_copy_is_made_at_once(work: Work) -> None:
    assert run(COPIES, FEW).output == run(COPIES, MANY).output == ["copied"]
    assert work.collections < 40


@pytest.mark.few(0)
def test_a_call_whose_parts_do_not_all_fit_is_over_the_limit(work: Work) -> None:
    """A call of a `together`: its frame, a copy of its arguments, its ticket; each part alone would fit."""
    body = """
    Post p = findPost("post0");
    Node n = null;
    for (int i = 0; i < count; i = i + 1) n = new Node(n, i);
    try { together { p.take(n); } print("called"); } catch (LimitException e) { print("full"); }
    """
    outputs = {run(body, count, limits=AgentLimits(heap=16 << 10)).output[0] for count in range(240, 340)}
    assert outputs == {"called", "full"}
