"""`reserve`: what is taken, in which order, what calls carry, and what is given back on every way out."""

from __future__ import annotations

import pytest
from reserving_hosts import ReservingHosts, program, ran

from lfield.vm.agent import Agent, TeamMember

ALL = ["take r0", "take r1", "take r2"]
BACK = ["drop r0 7", "drop r1 8", "drop r2 9"]


@pytest.mark.parametrize(
    "who",
    [
        "r",
        "reversed()",
        "new Post[][] {{r[2]}, {r[0], r[1]}, {r[2], r[2]}}",
        "new Post[] {r[1], r[2], r[1], r[0]}",
    ],
)
def test_each_is_taken_once_in_one_order_host_by_host(who: str) -> None:
    joined = ran(f"reserve ({who}) {{ print(hops()); }} print(hops());")
    assert joined.kept == [*ALL, *BACK]
    assert (joined.printed, joined.route, joined.book.nested) == (["2", "2"], [0, 1, 2], [])


def test_one_is_taken_where_it_is() -> None:
    joined = ran("reserve (r[1]) { print(hops()); print(r[1].count()); print(hops()); }")
    assert (joined.printed, joined.route) == (["1", "0", "1"], [0, 1])
    assert joined.book.log == ["take r1", "serve r1 7", "drop r1 7"]


def test_nothing_is_nothing_to_take() -> None:
    joined = ran("reserve (new Post[0]) { print(1); } reserve (new Post[3][0]) { } print(hops());")
    assert (joined.printed, joined.book.log) == (["1", "0"], [])


@pytest.mark.parametrize(
    ("who", "said"),
    [
        ("none", "'reserve' of null"),
        ("many", "'reserve' of null"),
        ("new Post[] {r[0], null}", "'reserve' of null (element 1)"),
        ("new Post[3]", "'reserve' of null (element 0)"),
        ("new Post[][] {{r[0]}, null}", "'reserve' of null (element 1)"),
    ],
)
def test_null_throws_and_nothing_was_taken(who: str, said: str) -> None:
    joined = ran(
        f"Post none; Post[] many; try {{ reserve ({who}) {{ print(1); }} }}"
        " catch (NullException e) { print(e.message()); }"
    )
    assert (joined.printed, joined.book.log) == ([said], [])


def test_what_it_keeps_is_asked_once() -> None:
    joined = ran("Post one = r[0]; reserve (one) { one = r[1]; r[0] = r[2]; print(one.count()); }")
    assert joined.kept == ["take r0", "drop r0 7"]
    assert joined.served == []


# --- what calls carry -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "served"),
    [
        ("r[1].count();", ["r1 8"]),
        ("counted(r[1]);", ["r1 8"]),
        ("new Pair(r[2], r[0]).both();", ["r2 9", "r0 7"]),
        ("within (5) { try { r[0].count(); } finally { r[1].count(); } }", ["r0 7", "r1 8"]),
        ("while (true) { r[1].count(); break; }", ["r1 8"]),
        ("try { r[2].own(3); } catch (Own o) { r[0].count(); }", ["r2 9", "r0 7"]),
        ("sleep(1.0); yield(); r[2].count();", ["r2 9"]),
    ],
)
def test_a_call_carries_the_number_of_its_resource(body: str, served: list[str]) -> None:
    joined = ran(f"reserve (r) {{ {body} }}")
    assert (joined.served, joined.kept) == (served, [*ALL, *BACK])


def test_so_does_each_call_of_a_together() -> None:
    joined = ran("reserve (r) { together { for (Post one : r) one.work(2.0); } }")
    assert sorted(joined.served) == ["r0 7", "r1 8", "r2 9"]
    assert [machine.agents[f"r{i}"].served for i, machine in enumerate(joined.machines)] == [1, 1, 1]


def test_what_is_not_reserved_is_asked_for_only_while_somebody_has_it() -> None:
    joined = ran("reserve (r[1]) { r[0].count(); r[1].count(); } r[0].count();")
    assert joined.served == ["r1 7"]


def test_a_call_behind_the_block_carries_nothing() -> None:
    joined = ReservingHosts(program("reserve (r[0]) { } print(r[0].count());"))
    joined.run()
    # The host of this test never says that a resource is free again, so it is asked.
    assert (joined.served, joined.printed) == (["r0 0"], ["0"])


# --- refused, lost, waiting -----------------------------------------------------------------------------


def test_refused_in_the_middle_what_was_taken_is_given_back() -> None:
    joined = ReservingHosts(
        program(
            "try { reserve (r) { print(1); } }"
            " catch (ReservedException e) { print(e.source() + ': ' + e.message()); }".replace("'", '"')
        )
    )
    joined.book.refused.add("r1")
    joined.run()
    assert joined.kept == ["take r0", "take r1", "drop r0 7"]
    assert joined.printed == ["r1: r1 is reserved by pilot"]
    assert not joined.book.held


def test_a_host_that_cannot_be_reached_gives_back_what_was_taken() -> None:
    joined = ReservingHosts(
        program("try { reserve (r) { } } catch (UnreachableResourceException e) { print(e.message()); }")
    )
    joined.cut.add(2)
    joined.run()
    assert joined.kept == ["take r0", "take r1", "drop r0 7", "drop r1 8"]
    assert joined.printed == ["host 2 cannot be reached"]


def test_a_resource_that_is_gone_cannot_be_taken() -> None:
    joined = ReservingHosts(program("try { reserve (r) { } } catch (Exception e) { print(e.message()); }"))
    joined.still()
    del joined.machines[1].agents["r1"]
    joined.run()
    assert joined.printed == ["r1 is not available: its host does not run it"]
    assert joined.kept == ["take r0", "drop r0 7"]


def test_who_waits_is_asked_again_and_has_what_it_had() -> None:
    joined = ReservingHosts(program("reserve (r) { print(1); }"))
    joined.book.busy.add("r1")
    joined.run()
    host, boss = joined.boss
    assert (host, boss.frozen, joined.printed) == (1, True, [])
    assert joined.machines[1].held_reservations.of_coordinator(boss) == [(joined.team[0], 7)]
    assert joined.machines[1].itinerary.current_target(boss) == (joined.team[1], "")
    joined.machines[1].unfreeze(boss)
    joined.run()
    assert joined.boss[1].frozen
    joined.book.busy.clear()
    joined.machines[1].unfreeze(boss)
    joined.run()
    assert joined.printed == ["1"]
    assert joined.kept == ["take r0", *["take r1"] * 3, "take r2", *BACK]


def test_who_waits_may_be_told_why_not() -> None:
    joined = ReservingHosts(program("reserve (r) { print(1); }"))
    joined.book.busy.add("r1")
    joined.run()
    joined.machines[1].resume(joined.boss[1], "ReservedException", "r1 is reserved by pilot for 5 s", "r1")
    joined.run()
    assert joined.death == "ReservedException: r1 is reserved by pilot for 5 s"
    assert joined.kept == ["take r0", "take r1", "drop r0 7"]


def test_a_stale_number_throws_before_the_portal_begins() -> None:
    joined = ReservingHosts(
        program(
            "reserve (r[1]) { sleep(1.0); try { r[1].work(1.0); } catch (ReservationLostException e)"
            " { print(e.source() + e.message()); } } print(r[2].count());"
        )
    )
    joined.run(until=0.5)
    joined.book.held["r1"] = 99
    joined.run()
    assert joined.printed == ["r1r1 was reserved by pilot since", "0"]
    assert joined.machines[1].agents["r1"].served == 0
    assert (joined.kept, joined.book.held) == (["take r1", "drop r1 7"], {"r1": 99})


def test_a_number_is_compared_where_nobody_has_the_resource_any_more() -> None:
    joined = ReservingHosts(program("reserve (r[1]) { sleep(1.0); r[1].work(1.0); }"))
    joined.run(until=0.5)
    joined.book.held.clear()
    joined.machines[1].agents["r1"].reserved = False
    joined.run()
    assert joined.death == "ReservationLostException: r1 was reserved by pilot since"
    assert joined.machines[1].agents["r1"].served == 0


def test_in_a_together_it_is_the_outcome_of_that_call() -> None:
    joined = ReservingHosts(
        program(
            "reserve (r) { sleep(1.0); try { together { for (Post one : r) one.work(2.0); } }"
            " catch (ReservationLostException e) { print(e.source()); } }"
            " reserve (r) { print(r[0].count()); print(r[2].count()); }"
        )
    )
    joined.run(until=0.5)
    joined.book.held["r1"] = 99
    joined.run()
    assert sorted(joined.printed) == ["1", "1", "r1"]
    assert joined.machines[1].agents["r1"].served == 0


RESERVED = """
try { %s } catch (ReservedException e) { print(e.source() + " " + e.message()); }
print(i2s(r[0].count()) + i2s(r[1].count()) + i2s(r[2].count()));
"""


@pytest.mark.parametrize("calls", ["r[1].work(1.0);", "together { for (Post one : r) one.work(1.0); }"])
def test_the_call_of_somebody_else_waits_until_it_is_told_why_not(calls: str) -> None:
    joined = ReservingHosts(program(RESERVED % calls))
    joined.machines[1].agents["r1"].reserved = True
    joined.book.busy.add("r1")
    joined.run(until=3.0)
    host, boss = joined.boss
    assert (host, boss.frozen) == (1, True)
    joined.machines[1].resume(boss, "ReservedException", "r1 is reserved by pilot", "r1")
    joined.machines[1].agents["r1"].reserved = False
    joined.run()
    both = "together" in calls
    assert sorted(joined.printed) == sorted(
        ["101" if both else "000", f"r1 r1 is reserved by pilot{' (r1.work() has not begun)' * both}"]
    )


@pytest.mark.parametrize("calls", ["r[1].work(1.0);", "together { for (Post one : r) one.work(1.0); }"])
def test_or_until_it_is_served(calls: str) -> None:
    joined = ReservingHosts(program(RESERVED % calls))
    joined.machines[1].agents["r1"].reserved = True
    joined.book.busy.add("r1")
    joined.run(until=3.0)
    joined.book.busy.clear()
    joined.machines[1].unfreeze(joined.boss[1])
    joined.run()
    assert joined.printed == ["111" if "together" in calls else "010"]


@pytest.mark.parametrize(
    "calls",
    ["r[1].work(1.0);", "together { for (Post one : r) one.work(1.0); }", "reserve (r) { r[1].work(1.0); }"],
)
def test_a_host_may_let_it_ask_again_at_once(calls: str) -> None:
    """Who has no disk has nothing to wait for, and says so while it is asked."""
    joined = ReservingHosts(program(RESERVED % calls))
    machine = joined.machines[1]
    machine.agents["r1"].reserved = True
    joined.book.busy.add("r1")
    joined.run(until=1.0)
    boss = machine.agents["boss"]
    book, place = joined.book, joined.places[1]
    take, serves = place.acquire_reservation, place.may_serve

    def let() -> None:
        book.busy.clear()
        machine.unfreeze(boss)

    def taken(agent: Agent, resource: TeamMember, *, nested: bool) -> int:
        number = take(agent, resource, nested=nested)
        if book.busy:
            let()
        return number

    def served(agent: Agent, resource: TeamMember, number: int) -> bool:
        answer = serves(agent, resource, number)
        if book.busy:
            let()
        return answer

    place.acquire_reservation, place.may_serve = taken, served  # type: ignore[method-assign]
    machine.unfreeze(boss)
    joined.run()
    assert joined.printed == ["111" if "together" in calls else "010"]


def test_in_a_together_the_others_of_that_host_go_on() -> None:
    """Two calls of one host, of which one is reserved by somebody else: only that one throws."""
    joined = ReservingHosts(
        program("try { together { r[1].work(1.0); r[2].work(1.0); } } catch (Exception e) { }")
    )
    joined.team[2:3] = [TeamMember(2, "r2", "Post", "resource", 1)]
    machine = joined.restart(1)
    machine.start(joined.team[2], joined.limits, 0)
    joined.still()
    machine.agents["r1"].reserved = True
    joined.book.busy.add("r1")
    joined.run(until=1.0)
    machine.resume(machine.agents["boss"], "ReservedException", "r1 is reserved by pilot", "r1")
    joined.run(until=0.5)
    assert [begun.resource for begun in machine.pending_calls.calls()] == ["r2"]


# --- nested ---------------------------------------------------------------------------------------------


def test_a_nested_one_must_not_wait_and_takes_nothing_twice() -> None:
    joined = ran(
        "reserve (r[1]) { reserve (r) { r[1].count(); } r[1].count(); reserve (r[1]) { r[1].count(); } }"
    )
    assert joined.kept == ["take r1", "take r0", "take r2", "drop r0 8", "drop r2 9", "drop r1 7"]
    assert joined.served == ["r1 7"] * 3
    assert joined.book.nested == ["r0", "r2"]


def test_one_around_that_keeps_nothing_makes_none_nested() -> None:
    joined = ran("reserve (new Post[0]) { reserve (r) { } }")
    assert (joined.kept, joined.book.nested) == ([*ALL, *BACK], [])


def test_a_nested_one_that_is_refused_leaves_what_is_around_it() -> None:
    joined = ReservingHosts(
        program(
            "reserve (r[0]) { try { reserve (r) { } } catch (ReservedException e) { print(r[0].count()); } }"
        )
    )
    joined.book.refused.add("r2")
    joined.run()
    assert joined.kept == ["take r0", "take r1", "take r2", "drop r1 8", "drop r0 7"]
    assert (joined.served, joined.printed) == (["r0 7"], ["0"])


def test_methods_have_blocks_of_their_own() -> None:
    joined = ran("reserve (r[0]) { print(early(r[0])); print(early(r[1])); } print(early(r[0]));")
    assert joined.kept == ["take r0", "take r1", "drop r1 8", "drop r0 7", "take r0", "drop r0 9"]
    assert joined.printed == ["0", "0", "0"]


# --- ways out -------------------------------------------------------------------------------------------


LIMITED = "try { within (1.0) { reserve (r) { %s } } } catch (TimeLimitException e) { }"


@pytest.mark.parametrize(
    ("body", "death"),
    [
        ("reserve (r) { }", ""),
        ("reserve (r) { return; }", ""),
        ("while (true) { reserve (r) { break; } }", ""),
        ("for (int i = 0; i < 1; i += 1) { reserve (r) { if (i == 0) continue; } }", ""),
        ("try { reserve (r) { throw new Own(1); } } catch (Own o) { }", ""),
        ("reserve (r) { throw new IndexException(i2s(4)); }", "IndexException: 4"),
        ("reserve (r) { print(1 / (hops() - 2)); }", "ArithmeticException: division by zero"),
        ("reserve (r) { r[1].own(2); }", "Own"),
        ("reserve (r) { try { return; } finally { sleep(1.0); } }", ""),
        (LIMITED % "sleep(9.0);", ""),
        (LIMITED % "while (true) yield();", ""),
        (LIMITED % "r[1].heed(9.0);", ""),
        (LIMITED % "together { for (Post one : r) one.heed(9.0); }", ""),
        ("reserve (r) { within (1.0) { sleep(2.0); } }", "TimeLimitException: the time is over"),
    ],
)
def test_everything_is_given_back_once_on_every_way_out(body: str, death: str) -> None:
    joined = ran(body)
    assert (joined.kept, joined.death) == ([*ALL, *BACK], death)


def test_a_coordinator_that_waits_for_what_is_reserved_hears_that_its_time_is_over() -> None:
    joined = ReservingHosts(
        program(
            "try { within (2.0) { reserve (r) { } } } catch (TimeLimitException e) { print(e.message()); }"
        )
    )
    joined.book.busy.add("r1")
    joined.places[1].abandon_wait = lambda agent: True  # type: ignore[method-assign]  # its host waits no more
    joined.run(until=5.0)
    assert joined.printed == ["the time is over before r1 could be reserved"]
    assert joined.kept == ["take r0", "take r1", "drop r0 7"]


def test_giving_back_is_not_cut_short_by_a_limit_that_is_over() -> None:
    joined = ran(
        "real begun = now();"
        "try { within (1.0) { reserve (r) { try { sleep(9.0); } finally { sleep(3.0); } } } }"
        " catch (TimeLimitException e) { print(f2i(now() - begun)); }"
    )
    assert (joined.kept, joined.printed) == ([*ALL, *BACK], ["4"])


@pytest.mark.parametrize("allowed", ["", "count"])
def test_who_may_call_nothing_of_a_resource_does_not_keep_it_from_others(allowed: str) -> None:
    told = 'catch (AccessException e) { print(e.source() + ": " + e.message()); }'
    body = 'try { reserve (r) { print("in"); } }' + told
    joined = ReservingHosts(program(body))

    def rules(coordinator: str, resource: str, method: int) -> str:
        name = joined.program.core.methods[method].name
        return f"no {name}()" if resource == "r1" and name != allowed else ""

    for machine in joined.machines:
        machine.hooks.rules = rules
    joined.run()
    refused = "r1: r1 cannot be reserved by a coordinator that may not call it: no work()"
    assert joined.printed == ["in" if allowed else refused]
    assert joined.kept == ([*ALL, *BACK] if allowed else ["take r0", "drop r0 7"])
