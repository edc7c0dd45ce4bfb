"""Reservations in a block: stored, restored, recovered, inspected, and changed by a peer."""

from __future__ import annotations

from functools import cache

import pytest
from damaged_blocks import damaged_images
from hypothesis import given, settings
from hypothesis import strategies as st
from joined_hosts import CollectingHosts
from reserving_hosts import ReservingHosts, program

from lfield.errors import BlockError
from lfield.vm import machine as machine_module
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.inspection.block_view import view
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block

BODY = """
reserve (r) {
  print(r[0].count()); r[1].work(1.0); sleep(1.0);
  together { for (Post one : r) one.work(2.0); }
  while (hops() > 0) { yield(); print(counted(r[2])); break; }
}
print("behind");
"""


def waiting() -> ReservingHosts:
    """The boss waits in its second `take` and holds r0."""
    joined = ReservingHosts(program("reserve (r) { print(r[2].count()); }"))
    joined.book.busy.add("r1")
    joined.run()
    joined.book.busy.clear()
    return joined


def array_of(block: Block) -> int:
    """The address of the array of reservations in the block of `waiting`."""
    w = block.w
    ints = (
        at for at in range(block.heap, block.top - 6) if w[at] & 0xFF == layout.ARRAY and w[at] >> 32 == 7
    )
    return next(at for at in ints if w[at + 1 : at + 7].tolist() == [0, 7, 1, 0, 2, 0])


def test_held_reservations_are_known_at_every_step() -> None:
    joined = ReservingHosts(program(BODY))
    observed = []
    for _ in range(40):
        joined.still()
        host, boss = next(
            ((i, m.agents["boss"]) for i, m in enumerate(joined.machines) if "boss" in m.agents), (0, None)
        )
        if boss is None:
            break
        observed.append(
            tuple(
                (member.id, number)
                for member, number in joined.machines[host].held_reservations.of_coordinator(boss)
            )
        )
        if not joined.carry():
            joined.clock.advance(0.5)
    whole = (("r0", 7), ("r1", 8), ("r2", 9))
    assert list(dict.fromkeys(observed)) == [(("r0", 7),), (("r0", 7), ("r1", 8)), whole]
    assert joined.printed == ["0", "1", "behind"]


def test_a_block_view_shows_the_reservations() -> None:
    joined = waiting()
    frame_locals = view(joined.boss[1].block, joined.program, [member.id for member in joined.team])
    assert frame_locals.threads[0].frames[0].reserved == ("r0, by number 7",)


def test_a_block_view_shows_no_reservations_after_the_block() -> None:
    joined = ReservingHosts(program("reserve (r) { } sleep(5.0);"))
    joined.run(until=1.0)
    host, boss = joined.boss
    frame_locals = view(boss.block, joined.program, [member.id for member in joined.team])
    assert frame_locals.threads[0].frames[0].reserved == ()
    assert joined.machines[host].held_reservations.of_coordinator(boss) == []


@pytest.mark.parametrize(("word", "value"), [(1, 3), (1, 4), (1, -1), (2, -7), (2, layout.COUNT_LIMIT)])
def test_invalid_numbers_in_a_block_are_no_reservations(word: int, value: int) -> None:
    joined = waiting()
    host, boss = joined.boss
    boss.block.w[array_of(boss.block) + word] = value
    assert joined.machines[host].held_reservations.of_coordinator(boss) == []
    joined.machines[host].unfreeze(boss)
    joined.still()
    # The coordinator continues here; the next host would refuse its block.
    assert (joined.death, boss.frozen) == ("", True)


def test_a_restored_coordinator_continues_its_reservations() -> None:
    joined = waiting()
    host, boss = joined.boss
    image = bytes(joined.machines[host].pack(boss))
    machine = joined.restart(host)
    restored = machine.restore(boss.member, image, boss.limits)
    assert machine.itinerary.may_continue(restored)
    assert machine.itinerary.current_target(restored) == (joined.team[1], "")
    assert machine.held_reservations.of_coordinator(restored) == [(joined.team[0], 7)]
    machine.unfreeze(restored)
    joined.run()
    assert joined.printed == ["0"]
    assert joined.kept == ["take r0", "take r1", "take r1", "take r2", "drop r0 7", "drop r1 8", "drop r2 9"]


def test_a_coordinator_restored_in_a_portal_call_does_not_continue() -> None:
    joined = ReservingHosts(
        program("try { reserve (r) { r[1].work(9.0); } } catch (RestartException e) { print(1); }")
    )
    joined.run(until=1.0)
    host, boss = joined.boss
    image = bytes(joined.machines[host].pack(boss))
    machine = joined.restart(host)
    restored = machine.restore(boss.member, image, boss.limits)
    assert not machine.itinerary.may_continue(restored)
    machine.resume(restored, "RestartException", "it may have been done", "r1")
    joined.run()
    assert joined.printed == ["1"]
    assert joined.kept[3:] == ["drop r0 7", "drop r1 8", "drop r2 9"]


def test_a_recovered_coordinator_releases_its_numbers_after_an_exception() -> None:
    joined = waiting()
    host, boss = joined.boss
    image = bytes(joined.machines[host].pack(boss))
    joined.machines[host].release(boss)
    restored = joined.machines[host].restore(boss.member, image, boss.limits)
    restored.block.w[layout.W_GENERATION] = 5
    joined.machines[host].resume(restored, "RestartException", "it was recovered", recovered=True)
    joined.run()
    assert joined.death == "RestartException: it was recovered"
    assert joined.kept == ["take r0", "take r1", "drop r0 7"]


def test_an_acting_call_after_a_reservation_needs_a_new_page() -> None:
    """The coordinator hopped to r1, so its page is from `take`; an acting portal needs a new page."""
    joined = ReservingHosts(program("reserve (r[1]) { r[1].work(1.0); }"))
    requests = []
    joined.places[1].may_start_call = lambda agent, acts: requests.append(agent.is_persisted) or True  # type: ignore[method-assign]
    joined.run()
    assert requests == [False]


def test_an_acting_call_after_a_fetch_needs_a_new_page() -> None:
    joined = ReservingHosts(program("together { r[1].work(5.0); r[2].work(1.0); } r[1].work(1.0);"))
    requests = []
    joined.places[1].may_start_call = lambda agent, acts: requests.append(agent.is_persisted) or True  # type: ignore[method-assign]
    joined.run()
    assert joined.route == [0, 1, 2, 1]
    assert requests == [False]


def test_calls_of_other_coordinators_are_reported() -> None:
    joined = ReservingHosts(program("together { r[0].work(5.0); r[1].work(5.0); } r[1].work(5.0);"))
    joined.still()
    machine, resource = joined.machines[1], joined.machines[1].agents["r1"]
    assert not machine.served_calls.has_others(resource, "pilot")
    joined.run(until=1.0)
    assert machine.served_calls.has_others(resource, "pilot")
    assert not machine.served_calls.has_others(resource, "boss")
    joined.run(until=6.0)
    boss = machine.agents["boss"]
    assert (
        machine.served_calls.has_others(resource, "pilot"),
        machine.served_calls.has_others(resource, "boss"),
    ) == (
        True,
        False,
    )
    # The detached call has no caller.
    assert machine.detach_caller(boss, "RestartException", "it was fenced")
    assert machine.served_calls.has_others(resource, "boss")
    joined.run()
    assert not machine.served_calls.has_others(resource, "pilot")


def test_a_failed_resource_has_no_calls() -> None:
    joined = ReservingHosts(program("r[1].work(5.0);"))
    joined.run(until=1.0)
    resource = joined.machines[1].agents["r1"]
    resource.ended = "died"
    assert not joined.machines[1].served_calls.has_others(resource, "pilot")


@pytest.mark.parametrize(
    ("word", "value"),
    [
        (1, 3),  # a coordinator
        (1, 4),  # no member
        (1, -1),
        (1, 1),  # twice
        (2, -7),
        (2, layout.COUNT_LIMIT),
        (0, None),  # a missing number
    ],
)
def test_a_block_with_impossible_reservations_is_refused(word: int, value: int | None) -> None:
    joined = waiting()
    host, boss = joined.boss
    machine = joined.machines[host]
    machine.pack(boss)
    machine.restore(boss.member, bytes(boss.block.image()), boss.limits)
    w, array = boss.block.w, array_of(boss.block)
    if value is None:
        # The last word becomes an array without elements.
        w[array + 6] = w[array] & 0xFFFFFFFF | 1 << 32
        w[array] -= 1 << 32
    else:
        w[array + word] = value
    with pytest.raises(BlockError, match="reservations are not valid"):
        machine.restore(boss.member, bytes(boss.block.image()), boss.limits)


LONG = """
for (int i = 0; i < 3; i += 1) {
  reserve (reversed()) {
    print(new Pair(r[0], r[2]).both());
    try { reserve (r[i]) { r[i].work(0.5); if (i == 1) continue; r[i].own(i); } }
    catch (Own o) { print(o.n + early(r[1])); }
    within (3.0) { together { for (Post one : r) one.work(1.0); } }
  }
}
reserve (new Post[] {r[2]}) {
  try { within (1.0) { reserve (r) { r[1].heed(9.0); } } }
  catch (TimeLimitException e) { print(r[2].count()); }
}
"""


class CollectingReserving(CollectingHosts, ReservingHosts):
    """Hosts that collect garbage and have reservations."""


def whole(joined: ReservingHosts) -> tuple[list[str], list[str], dict[str, int]]:
    joined.run()
    return joined.printed, joined.book.log, joined.book.held


@pytest.mark.parametrize("kind", [ReservingHosts, CollectingReserving])
@pytest.mark.parametrize("slice_length", [1, 2, 3, 17])
def test_interruptions_do_not_change_the_requests(
    kind: type[ReservingHosts], slice_length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = whole(ReservingHosts(program(LONG)))
    assert len(expected[0]) == 7
    assert not expected[2]
    monkeypatch.setattr(machine_module, "SLICE", slice_length)
    for name in ("SLICES_PER_RUN", "TURNS_PER_RUN"):
        monkeypatch.setattr(machine_module, name, 1 if kind is CollectingReserving else 200)
    assert whole(kind(program(LONG))) == expected


@cache
def images() -> tuple[tuple[int, bytes], ...]:
    """Every block of a hop, with its target."""
    found: list[tuple[int, bytes]] = []

    class Noting(ReservingHosts):
        def leave(self, source, agent, target):  # type: ignore[no-untyped-def]
            found.append((target, bytes(self.machines[source].pack(agent))))
            super().leave(source, agent, target)

    Noting(program(LONG)).run()
    return tuple(found)


@pytest.mark.few(0)
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_hostile_reservations_are_refused_or_harmless(data: st.DataObject) -> None:
    """Any change of a block with reservations by a peer gives a BlockError or a normal run."""
    target, image = data.draw(damaged_images(images()))
    joined = ReservingHosts(program(LONG))
    joined.machines[0].agents.pop("boss").ended = "dropped"
    machine = joined.machines[target]
    try:
        agent = machine.inject(joined.team[3], image, AgentLimits())
    except BlockError:
        return
    machine.itinerary.current_target(agent)
    machine.itinerary.may_continue(agent)
    machine.held_reservations.of_coordinator(agent)
    machine.unfreeze(agent)
    joined.run()
    assert "bug in lfield" not in agent.report
