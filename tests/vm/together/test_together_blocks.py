"""A together in a block: interrupted anywhere, collected, packed, and changed by a peer."""

from __future__ import annotations

from functools import cache

import pytest
from damaged_blocks import damaged_images
from hypothesis import given, settings
from hypothesis import strategies as st
from joined_hosts import CollectingHosts, JoinedHosts

from lfield.bytecode.program import Program
from lfield.errors import BlockError
from lfield.testing.golden import compile_text
from lfield.vm import machine as machine_module
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.inspection.block_view import view
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block

BUSY = """
class Card { public string text; public Card self; public Card(string t) { text = t; self = this; } }
class Own { public int n; public Own(int n) { this.n = n; } }
resource Post {
  string name; int done;
  init(string[] arg) { name = arg[0]; }
  portal stamp(Card card, real s) emit Card { sleep(s); card.text = card.text + name; return card; }
  portal count(int n) emit int { sleep(0.5); done = done + n; return done; }
  portal fail(string why) { sleep(0.2); throw new IndexException(why); }
  portal own(int n) { throw new Own(n); }
}
coordinator Boss {
  init(string[] arg) {
    Post[] r = findPost(); Card[] c = new Card[3]; int[] n = new int[3]; Card mine = new Card("c"); int x = 0;
    int zero = r[1].count(0);
    together {
      for (int i = 0; i < 3; i = i + 1) { c[i] = r[i].stamp(mine, 1.0 - i * 0.3); n[i] = r[i].count(i); }
    }
    for (int i = 0; i < 3; i = i + 1) print(c[i].text + b2s(c[i].self == c[i]) + i2s(n[i]));
    try { together { x = r[1].count(5); r[2].fail("one"); mine.text = ""; r[0].fail("two"); } }
    catch (IndexException e) { print(e.message() + e.others()[0].message() + i2s(x)); }
    try {
      within (3.0) { together { c[0] = r[2].stamp(mine, 9.0); sleep(0.1); x = r[0].count(1); } }
    }
    catch (TimeLimitException e) { print(e.message()); }
    try { together { x = r[1].count(5); c[0] = r[2].stamp(mine, 4.0); sleep(1.0); print(1 / zero); } }
    catch (ArithmeticException e) { print(i2s(x) + c[0].text); }
    try { together { r[1].own(6); r[2].own(7); } }
    catch (Own o) { Exception e = o; print(i2s(o.n + r[2].count(0)) + e.others()[0].type()); }
  }
}
"""
SAID = [
    "cr0true0",
    "cr1true1",
    "cr2true2",
    "r0.fail() also failed: IndexException: two",
    "onetwo0",
    "the time is over; r2.stamp() was cancelled; r0.count() has completed",
    "0cr0",
    "r2.own() also failed: Own {7}",
    "8Own",
]


@cache
def program() -> Program:
    return compile_text(BUSY)


@pytest.mark.parametrize("kind", [JoinedHosts, CollectingHosts])
@pytest.mark.parametrize("slice_length", [1, 2, 3, 17, 100_000])
def test_interruptions_do_not_change_the_output(
    kind: type[JoinedHosts], slice_length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine_module, "SLICE", slice_length)
    for name in ("SLICES_PER_RUN", "TURNS_PER_RUN"):
        monkeypatch.setattr(machine_module, name, 1 if kind is CollectingHosts else 200)
    joined = kind(program(), 3)
    joined.run()
    # The coordinator prints on several hosts; each line appears once.
    assert sorted(joined.printed) == sorted(SAID)


def test_results_that_exceed_the_heap_throw() -> None:
    text = """
    resource Post { init(string[] arg) { } portal much() emit int[] { sleep(0.1); return new int[900]; } }
    coordinator Boss { init(string[] arg) {
      Post[] r = findPost(); int[] a = null; int[] b = null; int[] c = null;
      try { together { a = r[0].much(); b = r[1].much(); c = r[0].much(); } }
      catch (LimitException e) { print("too much"); }
      together { a = r[1].much(); }
      print(a.length());
    } }"""
    joined = JoinedHosts(compile_text(text), 2, limits=AgentLimits(heap=8 * 2000))
    joined.run()
    assert joined.printed[-2:] == ["too much", "900"]


@cache
def images() -> tuple[tuple[int, bytes], ...]:
    """Every block of a hop, with its target."""
    found: list[tuple[int, bytes]] = []

    class Noting(JoinedHosts):
        def leave(self, source, agent, target):  # type: ignore[no-untyped-def]
            found.append((target, bytes(self.machines[source].pack(agent))))
            super().leave(source, agent, target)

    Noting(program(), 3).run()
    return tuple(found)


def test_only_live_data_migrates() -> None:
    sizes = [len(image) for _, image in images()]
    # The arguments of a started call stay on its host.
    assert max(sizes) < 4000
    assert min(sizes) < max(sizes)


def kinds(image: bytes) -> list[int]:
    """The kinds of the objects on a heap, in order."""
    block = Block(bytearray(image), len(image) // 8, len(image) // 8)
    found, place = [], block.heap
    while place < block.top:
        found.append(block.w[place] & 0xFF)
        place += block.w[place] >> 32
    return found


def test_tickets_are_removed_after_their_together() -> None:
    last = [kinds(image).count(layout.TICKET) for _, image in images()]
    # The first hop is a call before the blocks; a block has six calls and one group ticket.
    assert last[0] == 0
    assert max(last) == 7


def test_a_block_view_shows_the_states_of_calls() -> None:
    joined = JoinedHosts(program(), 3)
    joined.cut.add(2)
    observed: set[str] = set()
    for _ in range(40):
        joined.run(until=0.1)
        for machine in joined.machines:
            if (boss := machine.agents.get("boss")) is not None:
                frame_locals = view(boss.block, joined.program, [member.id for member in joined.team])
                observed.update(
                    call for thread in frame_locals.threads for frame in thread.frames for call in frame.calls
                )
                assert any(name == "call of a together" for name, _, _ in frame_locals.heap) or not observed
    assert {
        "r0.stamp() started",
        "r2.count() returned with UnreachableResourceException",
    } <= observed


@pytest.mark.few(1)
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_hostile_togethers_are_refused_or_harmless(data: st.DataObject) -> None:
    """Any change of a block with tickets by a peer gives a BlockError or a normal run."""
    target, image = data.draw(damaged_images(images()))
    joined = JoinedHosts(program(), 3)
    joined.machines[0].agents.pop("boss").ended = "dropped"
    try:
        agent = joined.machines[target].inject(joined.team[3], image, AgentLimits())
    except BlockError:
        return
    joined.machines[target].itinerary.current_target(agent)
    joined.machines[target].itinerary.may_continue(agent)
    joined.machines[target].unfreeze(agent)
    joined.run()
    assert "bug in lfield" not in agent.report


@pytest.mark.parametrize("word", [layout.W_GENERATION, layout.W_SEQUENCE, layout.W_HOPS])
@pytest.mark.parametrize("value", [-1, layout.COUNT_LIMIT])
def test_an_impossible_counter_is_refused(word: int, value: int) -> None:
    """The check is made before a ticket exists: the next host would refuse its number during calls."""
    target, sound = images()[0]
    image = bytearray(sound)
    image[8 * word : 8 * word + 8] = value.to_bytes(8, "little", signed=True)
    joined = JoinedHosts(program(), 3)
    joined.machines[0].agents.pop("boss").ended = "dropped"
    with pytest.raises(BlockError):
        joined.machines[target].inject(joined.team[3], bytes(image), AgentLimits())


def test_a_block_of_the_previous_version_continues() -> None:
    """A block of version 2 has no clock and no tickets in its header, which is two words shorter."""
    target, image = images()[0]
    assert layout.TICKET not in kinds(image)
    earlier = in_version_2(image)
    joined = JoinedHosts(program(), 3)
    joined.machines[0].agents.pop("boss").ended = "dropped"
    joined.machines[target].unfreeze(joined.machines[target].inject(joined.team[3], earlier, AgentLimits()))
    joined.run()
    assert sorted(joined.printed) == sorted(SAID)


def test_a_block_of_the_previous_version_with_tickets_is_refused() -> None:
    target, image = images()[2]
    assert layout.TICKET in kinds(image)
    joined = JoinedHosts(program(), 3)
    with pytest.raises(BlockError, match="has no tickets"):
        joined.machines[target].inject(joined.team[3], in_version_2(image), AgentLimits())


def in_version_2(image: bytes) -> bytes:
    """The block in the format of the previous version, with tickets."""
    old = Block(bytearray(image), len(image) // 8, len(image) // 8)
    w = old.w
    less = layout.HEADER_WORDS - layout.HEADERS[layout.EARLIER_VERSION]
    layouts = JoinedHosts(program(), 1).machines[0].layouts
    place = old.heap
    while place < old.top:
        for offset in layouts.references(w[place]):
            w[place + offset] -= less if w[place + offset] else 0
        place += w[place] >> 32
    for root in layout.ROOTS:
        w[root] -= less if w[root] else 0
    w[layout.W_MAGIC] = layout.MAGIC | layout.EARLIER_VERSION << 32
    w[layout.W_TOP] = old.top - less
    return old.data[: 8 * layout.W_CLOCK] + old.data[8 * layout.HEADER_WORDS :]
