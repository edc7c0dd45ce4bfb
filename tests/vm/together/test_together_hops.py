"""A together on several hosts: the hops of the coordinator; unreachable hosts, stored and lost results."""

from __future__ import annotations

from functools import cache

import pytest
from joined_hosts import JoinedHosts

from lfield.bytecode.program import Program
from lfield.errors import BlockError
from lfield.testing.golden import compile_text
from lfield.vm.memory import layout
from lfield.vm.pending_call import PendingCall

POSTS = """
class Card { public string text; public Card(string t) { text = t; } }
resource Post {
  string name; int done;
  init(string[] arg) { name = arg[0]; }
  portal work(real s, Card card) emit Card {
    try { sleep(s); } catch (CancelledException e) { print(name + " cancelled"); sleep(0.5); throw e; }
    done = done + 1; card.text = card.text + name; return card;
  }
  portal count() emit int { return done; }
  portal fail(string why) { throw new ConversionException(why); }
  portal synchronized one(real s) { sleep(s); done = done + 1; }
}
coordinator Boss {
  init(string[] arg) {
    Post[] r = findPost(); Card[] c = new Card[r.length()]; Card mine = new Card("c"); int x = 0; int y = 0;
    real begun = now();
    %s
  }
}
"""
ALL = "together { for (int i = 0; i < r.length(); i = i + 1) c[i] = r[i].work(2.0, mine); }"
TOLD = 'for (int i = 0; i < r.length(); i = i + 1) print(c[i].text); print("after " + f2s(now() - begun, 1));'


@cache
def program(body: str) -> Program:
    return compile_text(POSTS % body)


def run(body: str, hosts: int) -> JoinedHosts:
    joined = JoinedHosts(program(body), hosts)
    joined.run()
    return joined


@pytest.mark.parametrize("hosts", [1, 2, 3, 5, 16])
def test_a_together_takes_at_most_two_hops_a_host_and_the_time_of_one_call(hosts: int) -> None:
    joined = run(ALL + TOLD, hosts)
    assert joined.printed == [*[f"cr{i}" for i in range(hosts)], "after 2.0"]
    # One hop to each other host, and back from the last one to each host with unfetched results.
    assert len(joined.images) == 2 * (hosts - 1)
    assert len(joined.images) <= 2 * hosts


def test_one_visit_starts_all_calls_of_a_host() -> None:
    body = 'together { r[0].count(); r[1].count(); r[2].count(); r[1].fail("no"); r[0].count(); }'
    joined = run(f"try {{ {body} }} catch (ConversionException e) {{ print(e.message()); }}", 3)
    assert joined.route == [0, 1, 2, 0, 1]
    request_counts = [[len(calls) for calls in place.asked] for place in joined.places]
    assert request_counts == [[2], [2], [1]]
    assert joined.printed == ["no"]


def test_local_calls_need_no_hop() -> None:
    joined = run("together { x = r[0].count(); y = r[0].count(); } print(x + y);", 2)
    assert (joined.images, joined.printed) == ([], ["0"])


def test_an_unreachable_host_throws_only_for_its_calls() -> None:
    joined = JoinedHosts(
        program(f"try {{ {ALL} }} catch (Exception e) {{ print(e.message()); }} print(r[2].count());"), 3
    )
    joined.cut.add(1)
    joined.run()
    assert joined.printed == ["host 1 cannot be reached (r1.work() has not begun)", "1"]
    assert joined.route == [0, 2, 0, 2]


def test_a_host_lost_before_the_fetch_throws_for_its_calls() -> None:
    joined = JoinedHosts(program(f"try {{ {ALL} }} catch (Exception e) {{ print(e.source()); }}"), 3)
    joined.run(until=1.0)
    joined.cut.add(1)
    joined.run()
    assert joined.printed == ["r1"]


def test_a_call_left_behind_is_cancelled_at_the_next_visit() -> None:
    body = f"try {{ {ALL} }} catch (Exception e) {{ print(e.source()); }} sleep(1.0); print(r[1].count());"
    joined = JoinedHosts(program(body.replace("2.0", "i % 2 * 45.0 + 5.0")), 3)
    joined.run(until=1.0)
    joined.cut.add(1)
    joined.run(until=4.5)
    assert joined.printed == ["r1"]
    assert joined.machines[1].pending_calls.calls()
    joined.cut.clear()
    joined.run()
    # The call is cancelled before the next portal call there, and cleans up in parallel.
    assert joined.places[1].output == ["0", "r1 cancelled"]
    assert joined.machines[1].pending_calls.calls() == []


def test_calls_wait_for_the_permission_of_their_host() -> None:
    joined = JoinedHosts(program(ALL + TOLD), 2)
    joined.places[1].lets = False
    joined.run()
    host, boss = joined.boss
    assert (host, boss.frozen, joined.machines[1].pending_calls.calls()) == (1, True, [])
    assert joined.machines[1].itinerary.current_target(boss) == (joined.team[1], "work")
    assert not joined.machines[1].itinerary.may_continue(boss)
    joined.places[1].lets = True
    joined.machines[1].unfreeze(boss)
    joined.run()
    assert joined.printed == ["cr0", "cr1", "after 4.0"]


def test_refused_calls_have_not_started() -> None:
    joined = JoinedHosts(program(f"try {{ {ALL} }} catch (LimitException e) {{ print(e.message()); }}"), 2)
    joined.places[1].lets = False
    joined.run()
    joined.machines[1].resume(joined.boss[1], "LimitException", "the disk is full")
    joined.run()
    assert joined.printed == ["the disk is full (r1.work() has not begun)"]
    assert not joined.machines[1].pending_calls.calls()


def test_a_result_is_fetched_only_when_durable_and_then_acknowledged() -> None:
    joined = JoinedHosts(program(ALL + TOLD), 2)
    joined.places[1].keeps = False
    joined.run()
    assert joined.boss[0] == 1
    [pending_call] = joined.places[1].unkept
    assert (pending_call.key, pending_call.state, pending_call.portal) == (("boss", 1, 2), "done", "work")
    joined.machines[1].pending_calls.on_persisted(pending_call.key)
    agent = joined.boss[1]
    joined.still()
    assert joined.machines[1].pending_calls.drain_fetched(agent) == [pending_call.key]
    assert joined.machines[1].pending_calls.drain_fetched(agent) == []
    joined.run()
    assert joined.printed == ["cr0", "cr1", "after 2.0"]


def test_a_failed_resource_stores_an_exception_for_its_calls() -> None:
    body = f"try {{ {ALL} }} catch (UnreachableResourceException e) {{ print(e.source() + e.message()); }}"
    joined = JoinedHosts(program(body), 3)
    joined.run(until=1.0)
    machine = joined.machines[1]
    machine._scheduler.die(machine.agents["r1"], "a test")
    [pending_call] = machine.pending_calls.calls()
    assert (pending_call.state, pending_call.is_persisted) == ("thrown", True)
    joined.run()
    assert joined.printed == ["r1r1 has died: a test"]


def test_calls_of_a_failed_resource_do_not_start() -> None:
    body = f"try {{ {ALL} }} catch (UnreachableResourceException e) {{ print(e.message()); }}"
    joined = JoinedHosts(program(body), 2)
    joined.machines[1]._scheduler.die(joined.machines[1].agents["r1"], "a test")
    joined.run()
    assert joined.printed == ["r1 is not available: it died of a test"]


def test_a_restarted_host_has_lost_its_running_calls() -> None:
    joined = JoinedHosts(
        program(f"try {{ {ALL} {TOLD} }} catch (RestartException e) {{ print(e.message()); }}"), 3
    )
    joined.run(until=1.0)
    [pending_call] = joined.machines[1].pending_calls.calls()
    joined.restart(1, [PendingCall(*pending_call.key, pending_call.resource, pending_call.portal)])
    joined.run()
    assert joined.printed == ["its host restarted while r1.work() ran; it may have been executed"]
    assert joined.machines[1].pending_calls.calls() == []


def test_a_restarted_host_returns_its_stored_results() -> None:
    joined = JoinedHosts(program(ALL.replace("2.0", "2.0 - i") + TOLD), 3)
    joined.run(until=1.5)
    [pending_call] = joined.machines[1].pending_calls.calls()
    page = PendingCall(
        *pending_call.key,
        pending_call.resource,
        pending_call.portal,
        state="done",
        result=pending_call.result,
    )
    joined.restart(1, [page])
    joined.run()
    assert joined.printed == ["cr0", "cr1", "cr2", "after 2.0"]


def test_a_result_in_an_invalid_block_is_lost() -> None:
    joined = JoinedHosts(program(f"try {{ {ALL} }} catch (RestartException e) {{ print(e.source()); }}"), 2)
    joined.run(until=1.0)
    [pending_call] = joined.machines[1].pending_calls.calls()
    machine = joined.machines[0]
    machine.pending_calls.restore(
        [PendingCall(*pending_call.key, "r0", "work", state="done", result=b"12345678" * 50)]
    )
    assert machine.pending_calls.calls()[-1].state == "lost"


def test_a_later_start_does_not_fetch_results_of_an_earlier_one() -> None:
    joined = JoinedHosts(program(f"try {{ {ALL} }} catch (RestartException e) {{ print(e.message()); }}"), 3)
    joined.run(until=1.0)
    host, boss = joined.boss
    assert (host, boss.frozen) == (2, False)
    boss.block.w[layout.W_GENERATION] = 7
    joined.run()
    text = "boss was recovered since it called r%d.work(); the call may have been executed"
    assert joined.printed == [
        *(f"r{i}.work() also failed: RestartException: {text % i}" for i in (1, 2)),
        text % 0,
    ]
    assert joined.machines[1].pending_calls.cancel("boss", 1, "fenced") == []
    assert joined.machines[1].pending_calls.cancel("boss", 7, "fenced") == [("boss", 1, 2)]


def test_calls_of_a_forgotten_coordinator_are_cancelled_and_deleted() -> None:
    joined = JoinedHosts(program(ALL), 2)
    joined.run(until=1.0)
    assert joined.machines[0].pending_calls.cancel("boss", None, "boss is forgotten") == [("boss", 1, 1)]
    assert joined.machines[0].pending_calls.calls() == []
    joined.still()
    assert joined.places[0].output == ["r0 cancelled"]
    assert joined.machines[0].pending_calls.cancel("boss", None, "again") == []


def test_a_pause_fails_running_calls_whose_portals_continue() -> None:
    joined = JoinedHosts(program(f"try {{ {ALL} }} catch (RestartException e) {{ print(e.message()); }}"), 2)
    joined.run(until=1.0)
    joined.machines[0].pending_calls.fail_running("boss", "RestartException", "the mission was paused")
    [pending_call] = joined.machines[0].pending_calls.calls()
    assert (pending_call.state, pending_call.is_persisted) == ("thrown", True)
    joined.run()
    assert joined.printed == ["the mission was paused (r0.work)"]


def test_the_caller_of_a_portal_is_known_after_its_departure() -> None:
    joined = JoinedHosts(program(ALL), 2)
    joined.run(until=1.0)
    resource = joined.machines[0].agents["r0"]
    thread = resource.block.w[resource.block.w[layout.W_THREADS] + layout.THREAD_ID]
    caller = joined.machines[0].served_calls.caller(resource, thread)
    assert caller is not None
    assert (caller.id, caller.generation, caller.ended, caller.fenced) == ("boss", 1, "", False)
    number, _ = joined.machines[0].served_calls.of_thread(resource, thread)
    assert number
    joined.machines[0].pending_calls.fail_running("boss", "RestartException", "paused")
    assert joined.machines[0].served_calls.of_thread(resource, thread) == (number, None)


LIMIT = "catch (TimeLimitException e) { print(e.message()); }"
LEAVES = (
    "try { together { "
    "for (int i = 0; i < r.length(); i = i + 1) r[i].work(9.0, mine); sleep(1.0); x = x / y; } } "
)


def test_an_exit_cancels_the_calls_on_all_hosts_before_it_waits() -> None:
    joined = run(
        LEAVES + 'catch (ArithmeticException e) { print("left after " + f2s(now() - begun, 1)); }', 3
    )
    assert joined.route == [0, 1, 2, 0, 1, 0, 2]
    assert joined.places[2].output == ["r2 cancelled", "left after 1.5"]
    assert [place.output[0] for place in joined.places] == ["r0 cancelled", "r1 cancelled", "r2 cancelled"]
    assert [machine.pending_calls.calls() for machine in joined.machines] == [[], [], []]


def test_an_exit_does_not_wait_for_an_unreachable_host() -> None:
    joined = JoinedHosts(program(LEAVES + 'catch (ArithmeticException e) { print("left"); }'), 3)
    joined.run(until=0.5)
    joined.cut.add(0)
    joined.run()
    assert "left" in joined.printed
    assert not any("boss" in machine.agents for machine in joined.machines)


def test_a_coordinator_restored_during_a_fetch_continues() -> None:
    joined = JoinedHosts(program(ALL + TOLD), 2)
    joined.run(until=1.0)
    host, boss = joined.boss
    image = bytes(joined.machines[host].pack(boss))
    restored = joined.machines[host].restore(boss.member, image, boss.limits)
    assert joined.machines[host].itinerary.may_continue(restored)
    joined.machines[host].unfreeze(restored)
    joined.run()
    assert joined.printed == ["cr0", "cr1", "after 2.0"]


def test_a_recovery_exception_precedes_an_exit_or_a_time_limit() -> None:
    """The actions of an earlier start after it left the block, or after its time limit, are unknown."""
    handler = "catch (RestartException e) { print(e.message()); } catch (TimeLimitException e) { print(0); }"
    limited = "try { within (1.0) { " + ALL + " } } " + handler
    for body, until in ((LEAVES + handler, 1.2), (limited, 0.9)):
        joined = JoinedHosts(program(body), 3)
        joined.run(until=until)
        host, boss = joined.boss
        machine = joined.machines[host]
        restored = machine.restore(boss.member, bytes(machine.pack(boss)), boss.limits, 10.0)
        machine.resume(restored, "RestartException", "told", recovered=True)
        joined.run()
        assert "told" in joined.printed
        assert "0" not in joined.printed


def test_an_expired_lease_throws_during_a_fetch() -> None:
    joined = JoinedHosts(
        program(f"try {{ {ALL} }} catch (RestartException e) {{ print(e.message() + f2s(now() - begun)); }}"),
        2,
    )
    joined.run(until=1.0)
    host, boss = joined.boss
    assert joined.machines[host].detach_caller(boss, "RestartException", "the lease is over, after ")
    assert not joined.machines[host].detach_caller(boss, "RestartException", "twice")
    joined.run()
    assert joined.printed == ["r0 cancelled", "r1 cancelled", "the lease is over, after 1.5"]


def test_each_host_cancels_its_calls_at_the_time_limit() -> None:
    body = "try { within (1.0) { " + ALL + " } } catch (TimeLimitException e) { print(e.message()); }"
    joined = run(body + " print(now() - begun);", 3)
    text = "the time is over; r0.work() was cancelled; r1.work() was cancelled; r2.work() was cancelled"
    text += "; the block ends 0.5 s late: it waited for its calls and their hosts"
    # Each host has cancelled its calls at the same time.
    assert joined.printed == ["r0 cancelled", "r1 cancelled", "r2 cancelled", text, "1.5"]


def test_a_time_limit_includes_transfers_and_downtimes_of_hosts() -> None:
    joined = JoinedHosts(
        program(f"try {{ within (5.0) {{ r[1].work(9.0, mine); }} }} {LIMIT}"),
        2,
    )
    joined.still()
    agent, _ = joined.places[0].departures.pop()
    image = bytes(joined.machines[0].pack(agent))
    joined.machines[0].release(agent)
    arrived = joined.machines[1].inject(agent.member, image, agent.limits, downtime=4.5)
    joined.machines[1].unfreeze(arrived)
    joined.run(until=0.6)
    assert joined.places[1].output == ["r1 cancelled"]
    joined.run()
    assert (
        joined.printed[-1]
        == "the time is over; r1.work() was cancelled, 0.5 s late: it took that long to end"
    )


def test_a_time_limit_cancels_a_departure_that_has_not_started() -> None:
    body = "within (5.0) { r[1].count(); } "
    joined = JoinedHosts(
        program(f"try {{ {body} }} catch (TimeLimitException e) {{ print(e.message()); }}"), 2
    )
    assert joined.still() == 5.0
    joined.clock.advance(5.0)
    joined.still()
    assert joined.printed == ["the time is over before r1.count() could begin"]
    assert not joined.places[0].departures


def test_a_time_limit_is_reported_after_an_uncancellable_departure() -> None:
    joined = JoinedHosts(
        program(
            "try { within (5.0) { r[1].count(); } } catch (TimeLimitException e) { print(e.message()); }"
        ),
        2,
    )
    joined.still()
    agent, _ = joined.places[0].departures.pop()
    joined.clock.advance(6.0)
    joined.still()
    assert joined.printed == []
    joined.machines[0].resume(agent, "UnreachableResourceException", "host 1 is silent", "r1")
    joined.still()
    assert joined.printed == ["the time is over, 1.0 s late: host 1 is silent"]


def test_hostile_tickets_are_refused() -> None:
    joined = JoinedHosts(program(ALL), 2)
    joined.still()
    agent, _ = joined.places[0].departures.pop()
    image = bytes(joined.machines[0].pack(agent))
    w = memoryview(bytearray(image)).cast("q")
    tickets = [
        i for i in range(layout.HEADER_WORDS, len(w)) if w[i] & 0xFF == layout.TICKET and w[i] >> 32 == 12
    ]
    newest = next(place for place in tickets if w[place + layout.TICKET_NUMBER] == 2)
    faults = [
        (layout.TICKET_NEXT, newest),
        (layout.TICKET_NUMBER, 1),
        (layout.TICKET_NUMBER, 99),
        (layout.TICKET_NUMBER, 0),
        (layout.TICKET_STATE, 0),
        (layout.TICKET_STATE, 9),
        (layout.TICKET_STATE, layout.TICKET_RETURNED),
        (layout.TICKET_METHOD, 0),
        (layout.TICKET_METHOD, 10_000),
        (layout.TICKET_INDEX, 2),
        (layout.TICKET_INDEX, -1),
        (layout.TICKET_ARRAY, 0),
        (layout.TICKET_PROXY, 0),
        (layout.TICKET_CALL, 0),
        (layout.TICKET_CALL, newest),
        (layout.TICKET_VALUE, newest),
        (layout.TICKET_THROWN, newest),
        (layout.TICKET_GENERATION, -1),
    ]
    for field, word in faults:
        hostile = memoryview(bytearray(image)).cast("q")
        hostile[newest + field] = word
        with pytest.raises(BlockError):
            joined.machines[1].inject(agent.member, hostile.tobytes(), agent.limits)


def test_a_forbidden_call_throws_and_the_other_calls_start() -> None:
    handler = "try {" + ALL + '} catch (AccessException e) { print(e.source() + ": " + e.message()); }'
    work = next(i for i, m in enumerate(program(handler).core.methods) if m.name == "work")

    def rules(coordinator: str, resource: str, method: int) -> str:
        return "not this one" if (coordinator, resource, method) == ("boss", "r1", work) else ""

    joined = JoinedHosts(
        program(handler + "for (int i = 0; i < 3; i = i + 1) print(r[i].count());"), 3, rules=rules
    )
    joined.run()
    assert joined.printed == ["r1: not this one", "1", "0", "1"]
