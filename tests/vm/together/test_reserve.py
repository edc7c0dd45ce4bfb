"""`reserve`: the order of reservations, the numbers of calls, and the release at every exit."""

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
def test_resources_are_reserved_once_in_a_fixed_order_by_host(who: str) -> None:
    joined = ran(f"reserve ({who}) {{ print(hops()); }} print(hops());")
    assert joined.kept == [*ALL, *BACK]
    assert (joined.printed, joined.route, joined.book.nested) == (["2", "2"], [0, 1, 2], [])


def test_a_single_resource_is_reserved_on_its_host() -> None:
    joined = ran("reserve (r[1]) { print(hops()); print(r[1].count()); print(hops()); }")
    assert (joined.printed, joined.route) == (["1", "0", "1"], [0, 1])
    assert joined.book.log == ["take r1", "serve r1 7", "drop r1 7"]


def test_an_empty_array_reserves_nothing() -> None:
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
def test_null_throws_before_any_reservation(who: str, said: str) -> None:
    joined = ran(
        f"Post none; Post[] many; try {{ reserve ({who}) {{ print(1); }} }}"
        " catch (NullException e) { print(e.message()); }"
    )
    assert (joined.printed, joined.book.log) == ([said], [])


def test_the_reserved_expression_is_evaluated_once() -> None:
    joined = ran("Post one = r[0]; reserve (one) { one = r[1]; r[0] = r[2]; print(one.count()); }")
    assert joined.kept == ["take r0", "drop r0 7"]
    assert joined.served == []


# --- numbers of calls -----------------------------------------------------------------------------------


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


def test_each_call_of_a_together_carries_the_number_of_its_resource() -> None:
    joined = ran("reserve (r) { together { for (Post one : r) one.work(2.0); } }")
    assert sorted(joined.served) == ["r0 7", "r1 8", "r2 9"]
    assert [machine.agents[f"r{i}"].served for i, machine in enumerate(joined.machines)] == [1, 1, 1]


def test_a_call_of_an_unreserved_resource_is_checked_only_if_it_has_a_holder() -> None:
    joined = ran("reserve (r[1]) { r[0].count(); r[1].count(); } r[0].count();")
    assert joined.served == ["r1 7"]


def test_a_call_after_the_block_carries_no_number() -> None:
    joined = ReservingHosts(program("reserve (r[0]) { } print(r[0].count());"))
    joined.run()
    # The host of this test does not report a release, so the coordinator asks.
    assert (joined.served, joined.printed) == (["r0 0"], ["0"])


# --- refused, lost, waiting -----------------------------------------------------------------------------


def test_a_refused_reservation_releases_the_earlier_ones() -> None:
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


def test_an_unreachable_host_releases_the_earlier_reservations() -> None:
    joined = ReservingHosts(
        program("try { reserve (r) { } } catch (UnreachableResourceException e) { print(e.message()); }")
    )
    joined.cut.add(2)
    joined.run()
    assert joined.kept == ["take r0", "take r1", "drop r0 7", "drop r1 8"]
    assert joined.printed == ["host 2 cannot be reached"]


def test_a_missing_resource_cannot_be_reserved() -> None:
    joined = ReservingHosts(program("try { reserve (r) { } } catch (Exception e) { print(e.message()); }"))
    joined.still()
    del joined.machines[1].agents["r1"]
    joined.run()
    assert joined.printed == ["r1 is not available: its host does not run it"]
    assert joined.kept == ["take r0", "drop r0 7"]


def test_a_waiting_coordinator_retries_and_keeps_its_reservations() -> None:
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


def test_a_waiting_coordinator_can_be_refused_with_a_reason() -> None:
    joined = ReservingHosts(program("reserve (r) { print(1); }"))
    joined.book.busy.add("r1")
    joined.run()
    joined.machines[1].resume(joined.boss[1], "ReservedException", "r1 is reserved by pilot for 5 s", "r1")
    joined.run()
    assert joined.death == "ReservedException: r1 is reserved by pilot for 5 s"
    assert joined.kept == ["take r0", "take r1", "drop r0 7"]


def test_a_stale_number_throws_before_the_portal_starts() -> None:
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


def test_a_number_is_checked_after_the_resource_was_released() -> None:
    joined = ReservingHosts(program("reserve (r[1]) { sleep(1.0); r[1].work(1.0); }"))
    joined.run(until=0.5)
    joined.book.held.clear()
    joined.machines[1].agents["r1"].reserved = False
    joined.run()
    assert joined.death == "ReservationLostException: r1 was reserved by pilot since"
    assert joined.machines[1].agents["r1"].served == 0


def test_a_stale_number_in_a_together_is_the_outcome_of_its_call() -> None:
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
def test_a_call_of_a_reserved_resource_waits_until_it_is_refused(calls: str) -> None:
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
def test_a_call_of_a_reserved_resource_waits_until_it_is_served(calls: str) -> None:
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
def test_a_host_can_release_a_waiting_coordinator_within_its_request(calls: str) -> None:
    """A host without a disk does not wait, and unfreezes the coordinator within its request."""
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


def test_a_refused_call_in_a_together_leaves_the_other_calls_of_its_host() -> None:
    """Only the call of the resource that another coordinator has reserved throws."""
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
    assert [call.resource for call in machine.pending_calls.calls()] == ["r2"]


# --- nested ---------------------------------------------------------------------------------------------


def test_a_nested_reserve_does_not_wait_or_reserve_twice() -> None:
    joined = ran(
        "reserve (r[1]) { reserve (r) { r[1].count(); } r[1].count(); reserve (r[1]) { r[1].count(); } }"
    )
    assert joined.kept == ["take r1", "take r0", "take r2", "drop r0 8", "drop r2 9", "drop r1 7"]
    assert joined.served == ["r1 7"] * 3
    assert joined.book.nested == ["r0", "r2"]


def test_an_empty_outer_reserve_makes_no_inner_one_nested() -> None:
    joined = ran("reserve (new Post[0]) { reserve (r) { } }")
    assert (joined.kept, joined.book.nested) == ([*ALL, *BACK], [])


def test_a_refused_nested_reserve_keeps_the_outer_reservations() -> None:
    joined = ReservingHosts(
        program(
            "reserve (r[0]) { try { reserve (r) { } } catch (ReservedException e) { print(r[0].count()); } }"
        )
    )
    joined.book.refused.add("r2")
    joined.run()
    assert joined.kept == ["take r0", "take r1", "take r2", "drop r1 8", "drop r0 7"]
    assert (joined.served, joined.printed) == (["r0 7"], ["0"])


def test_methods_have_separate_reserve_blocks() -> None:
    joined = ran("reserve (r[0]) { print(early(r[0])); print(early(r[1])); } print(early(r[0]));")
    assert joined.kept == ["take r0", "take r1", "drop r1 8", "drop r0 7", "take r0", "drop r0 9"]
    assert joined.printed == ["0", "0", "0"]


# --- exits ----------------------------------------------------------------------------------------------


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
def test_every_exit_releases_all_reservations_once(body: str, death: str) -> None:
    joined = ran(body)
    assert (joined.kept, joined.death) == ([*ALL, *BACK], death)


def test_a_time_limit_ends_the_wait_for_a_reservation() -> None:
    joined = ReservingHosts(
        program(
            "try { within (2.0) { reserve (r) { } } } catch (TimeLimitException e) { print(e.message()); }"
        )
    )
    joined.book.busy.add("r1")
    joined.places[1].abandon_wait = lambda agent: True  # type: ignore[method-assign]  # ends the wait
    joined.run(until=5.0)
    assert joined.printed == ["the time is over before r1 could be reserved"]
    assert joined.kept == ["take r0", "take r1", "drop r0 7"]


def test_an_expired_limit_does_not_interrupt_the_release() -> None:
    joined = ran(
        "real begun = now();"
        "try { within (1.0) { reserve (r) { try { sleep(9.0); } finally { sleep(3.0); } } } }"
        " catch (TimeLimitException e) { print(f2i(now() - begun)); }"
    )
    assert (joined.kept, joined.printed) == ([*ALL, *BACK], ["4"])


@pytest.mark.parametrize("allowed", ["", "count"])
def test_a_coordinator_without_a_permitted_call_cannot_reserve_a_resource(allowed: str) -> None:
    handler = 'catch (AccessException e) { print(e.source() + ": " + e.message()); }'
    body = 'try { reserve (r) { print("in"); } }' + handler
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
