"""Futures on several hosts: the hops of the coordinator; unreachable hosts, lost calls, dropped futures."""

from __future__ import annotations

from functools import cache

import pytest
from joined_hosts import CollectingHosts, JoinedHosts

from lfield.bytecode.program import Program
from lfield.testing.golden import compile_text
from lfield.vm.memory.layout import CALLING, THREAD_STATE, W_THREADS

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
  portal fail(real s) emit Card { sleep(s); throw new ConversionException(name); }
}
coordinator Boss {
  future<Card> kept;
  private boolean isLast(Card c) { return c.text == "cr2"; }
  init(string[] arg) {
    Post[] r = findPost(); Card mine = new Card("c"); real start = now();
    %s
  }
}
"""
ALL = "future<Card>[] all = {}; for (Post one : r) all.append(async one.work(%s, mine));"


@cache
def program(body: str) -> Program:
    return compile_text(POSTS % body)


def run(body: str, hosts: int) -> JoinedHosts:
    joined = JoinedHosts(program(body), hosts)
    joined.run()
    return joined


@pytest.mark.parametrize("kind", [JoinedHosts, CollectingHosts])
def test_open_futures_migrate_and_are_fetched_on_their_hosts(kind: type[JoinedHosts]) -> None:
    body = (
        ALL % "2.0"
        + 'for (future<Card> f : all) print(f.await().text); print("after " + f2s(now() - start, 1));'
    )
    joined = kind(program(body), 3)
    joined.run()
    assert joined.printed == ["cr0", "cr1", "cr2", "after 2.0"]
    # One visit to each host to start, and one to each other host to fetch.
    assert joined.route == [0, 1, 2, 0, 1, 2]
    assert not any(machine.pending_calls.calls() for machine in joined.machines)


@pytest.mark.parametrize("hosts", [2, 3, 5])
def test_a_race_takes_one_hop_to_the_winner_and_two_to_cancel_each_other_host(hosts: int) -> None:
    body = (
        "future<Card>[] all = {};"
        "for (int i = 0; i < r.length(); i += 1) all.append(async r[i].work(9.0 - %s, mine));"
        'int i = all.race(); print(all[i].await().text + " " + f2s(round(now() - start), 0));'
    )
    joined = run(body % "4.0 * (1 - min(abs(i - 1), 1))", hosts)
    assert sorted(joined.printed) == sorted(["cr1 6", *(f"r{i} cancelled" for i in range(hosts) if i != 1)])
    starts, to_winner = hosts - 1, min(hosts - 2, 1)
    assert starts + to_winner < len(joined.images) <= starts + to_winner + 2 * (hosts - 1)


def test_immediate_cancellations_take_one_visit_to_each_host() -> None:
    body = (
        "future<Card>[] all = {async r[0].fail(9.0), async r[1].work(1.0, mine), async r[2].fail(9.0)};"
        "all.append(async r[3].fail(9.0)); print(all.race());"
    )
    joined = run(body, 4)
    # Hops to start each call, to the winner, and to each other host; all cancels are sent from the first one.
    assert joined.route == [0, 1, 2, 3, 1, 0, 2, 3, 0]
    assert joined.printed == ["1"]
    joined = JoinedHosts(program(body), 4)
    joined.run(until=0.5)
    joined.cut.add(2)
    joined.run()
    assert joined.printed == ["1"]
    assert [call.resource for call in joined.machines[2].pending_calls.calls()] == ["r2"]


def test_next_stays_on_its_host_and_takes_one_hop_for_each_result() -> None:
    body = (
        "future<Card>[] all = {async r[0].work(3.0, mine), async r[1].work(1.0, mine)};"
        "all.append(async r[2].work(2.0, mine));"
        "for (int i = all.next(); i >= 0; i = all.next()) { print(all[i].await().text); all[i] = null; }"
    )
    joined = run(body, 3)
    assert joined.route == [0, 1, 2, 1, 2, 0]
    assert [joined.places[i].output for i in range(3)] == [["cr0"], ["cr1"], ["cr2"]]


def test_a_race_with_a_condition_selects_a_result() -> None:
    joined = run(ALL % "1.0" + "int i = all.race(isLast); print(i);", 4)
    assert "2" in joined.printed
    assert sum("cancelled" in line for line in joined.printed) <= 1


def test_an_unreachable_host_throws_for_its_call() -> None:
    body = (
        "future<Card> f = async r[1].work(1.0, mine);"
        "try { f.await(); } catch (UnreachableResourceException e) { print(e.message()); } print(f.done());"
    )
    joined = JoinedHosts(program(body), 2)
    joined.cut.add(1)
    joined.run()
    assert joined.printed == ["host 1 cannot be reached (r1.work() has not begun)", "true"]


def test_a_branch_whose_host_is_lost_does_not_win() -> None:
    body = ALL % "2.0" + "int i = all.race(); print(i);"
    joined = JoinedHosts(program(body), 3)
    joined.run(until=1.0)
    joined.cut.add(1)
    joined.run()
    assert [line for line in joined.printed if line.isdigit()] in (["0"], ["2"])


def test_a_race_without_a_result_throws_the_first_exception_with_the_others() -> None:
    body = (
        "future<Card>[] all = {async r[1].work(2.0, mine), async r[2].fail(1.0), async r[0].fail(1.5)};"
        'try { all.race(); } catch (Exception e) { print(e.source() + " " + i2s(e.others().length())); }'
    )
    joined = JoinedHosts(program(body), 3)
    joined.run(until=0.5)
    joined.cut.add(1)
    joined.run()
    assert "r1 2" in joined.printed


def test_the_call_of_a_dropped_future_runs_to_its_end() -> None:
    counts = "print(r[0].count()); print(r[1].count());"
    body = f"kept = async r[1].work(5.0, mine); kept = null; {counts} sleep(9.0); {counts}"
    joined = JoinedHosts(program(body), 2)
    joined.run()
    assert sorted(joined.printed) == ["0", "0", "0", "1"]
    assert joined.machines[1].pending_calls.calls() == []


def test_the_failure_of_a_dropped_future_is_logged_at_the_next_visit() -> None:
    body = "kept = async r[1].fail(1.0); kept = null; print(r[0].count()); sleep(2.0); print(r[1].count());"
    joined = run(body, 2)
    assert "fail() failed, and its future was not awaited: ConversionException: r1" in joined.places[1].output


def test_a_future_reports_a_call_lost_by_a_restarted_host() -> None:
    body = (
        "kept = async r[1].work(5.0, mine); print(r[0].count()); sleep(2.0);"
        "try { kept.await(); } catch (RestartException e) { print(e.message()); }"
    )
    joined = JoinedHosts(program(body), 2)
    joined.run(until=1.0)
    calls = joined.machines[1].pending_calls.calls()
    joined.restart(1, calls)
    joined.run()
    assert joined.printed[-1] == "its host restarted while r1.work() ran; it may have been executed"


def test_a_stored_result_survives_a_restart_of_its_host() -> None:
    body = "kept = async r[1].work(1.0, mine); print(r[0].count()); sleep(3.0); print(kept.await().text);"
    joined = JoinedHosts(program(body), 2)
    joined.run(until=2.0)
    calls = joined.machines[1].pending_calls.calls()
    assert [call.state for call in calls] == ["done"]
    joined.restart(1, calls)
    joined.run()
    assert joined.printed[-1] == "cr1"


def test_simultaneous_results_end_one_wait_each() -> None:
    body = (
        "future<Card>[] all = {};"
        "for (int i = 0; i < 3; i += 1) all.append(async r[0].work(1.0, mine));"
        "for (int i = all.next(); i >= 0; i = all.next()) { print(i); all[i] = null; }"
    )
    joined = JoinedHosts(program(body), 1)
    joined.run(until=0.5)
    boss = joined.boss[1]
    assert boss.waits_for_any
    assert boss.block.w[boss.block.w[W_THREADS] + THREAD_STATE] == CALLING
    joined.run()
    assert joined.printed == ["0", "1", "2"]


def test_results_wait_for_the_disk() -> None:
    joined = JoinedHosts(program(ALL % "1.0" + "print(all.race());"), 1)
    joined.places[0].keeps = False
    joined.run()
    assert joined.printed == []
    [pending] = joined.places[0].unkept
    joined.machines[0].pending_calls.on_persisted(pending.key)
    joined.run()
    assert joined.printed == ["0"]


def test_a_waiting_coordinator_can_be_detached_with_an_exception() -> None:
    body = (
        ALL % "9.0"
        + "try { print(all.next()); } catch (UnreachableResourceException e) { print(e.message()); }"
    )
    joined = JoinedHosts(program(body), 2)
    joined.run(until=1.0)
    host, boss = joined.boss
    assert boss.waits_for_any
    assert joined.machines[host].detach_caller(boss, "UnreachableResourceException", "no majority")
    joined.run(until=1.0)
    assert "no majority" in joined.printed
    assert not joined.machines[host].detach_caller(boss, "UnreachableResourceException", "no majority")


def test_hints_for_another_start_or_agent_are_ignored() -> None:
    joined = JoinedHosts(program(ALL % "5.0" + "print(all.next());"), 2)
    joined.run(until=1.0)
    host, boss = joined.boss
    pending = joined.machines[host].pending_calls
    pending.on_ended_elsewhere("boss", boss.generation + 1, [1])
    pending.on_ended_elsewhere("nobody", boss.generation, [1])
    assert boss.waits_for_any
    # A false hint costs only a hop.
    pending.on_ended_elsewhere("boss", boss.generation, [1, 2])
    joined.run(until=1.0)
    assert joined.printed == []
    joined.run()
    assert joined.printed == ["0"] or joined.printed == ["1"]
