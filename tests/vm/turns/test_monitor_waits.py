"""`wait until`: a waiting thread costs nothing, is woken by others, and continues with the monitor."""

from __future__ import annotations

from functools import cache

import pytest
from joined_hosts import JoinedHosts

from lfield.bytecode.program import Program
from lfield.testing.golden import compile_text
from lfield.vm.memory import layout

QUEUE = """
resource Queue {
  int[] items = {}; int checks; int free;
  init(string[] arg) { }
  private boolean holds(int n) { checks = checks + 1; return items.length() > n; }
  portal synchronized get(int n) emit int { wait until (holds(n)); return items.length(); }
  portal synchronized soon(real s) emit int { wait until (holds(0)) within (s); return items.length(); }
  portal synchronized put(int n) { items.append(n); }
  portal synchronized nested() emit int { return inner(); }
  private synchronized int inner() { wait until (holds(1)); return items.length(); }
  portal synchronized keep(real s) { free = free + 1; sleep(s); }
  portal synchronized fails() { wait until (items[5] > 0); }
  portal synchronized late(real at) { wait until (now() >= at); }
  portal count() emit int { return checks; }
}
coordinator Boss {
  init(string[] arg) { Queue q = findQueue()[0]; %s }
}
"""


@cache
def program(body: str) -> Program:
    return compile_text(QUEUE % body)


def team(body: str) -> JoinedHosts:
    return JoinedHosts(program(body), 1, kind="Queue")


def test_waiting_threads_have_no_turns_while_their_resource_is_idle() -> None:
    joined = team(
        "future<int> a = async q.get(0); future<int> b = async q.get(1); print(a.await()); sleep(1.0);"
    )
    # None is ready, and no timer is set: neither for one waiting thread, nor for two that wake each other.
    assert joined.still() is None
    queue = joined.machines[0].agents["r0"]
    assert queue.block.w[layout.W_OWNER] == 0
    assert len(queue.monitor_waits) == 2
    assert joined.machines[0].run() is None


def test_each_thread_waits_for_its_own_condition_in_order_of_arrival() -> None:
    joined = team(
        "future<int>[] g = {async q.get(1), async q.get(0), async q.get(0)};"
        "sleep(1.0); q.put(7); for (int i = 1; i < 3; i += 1) print(g[i].await()); print(g[0].done());"
        "q.put(8); print(g[0].await()); print(q.count());"
    )
    joined.run()
    assert joined.printed[:4] == ["1", "1", "false", "2"]
    # Three at the start, three after the first put, one after the end of each get, one after the second put.
    assert joined.printed[4] == "9"


def test_a_monitor_entered_twice_is_left_and_entered_twice() -> None:
    joined = team(
        "future<int> n = async q.nested(); q.put(1); q.put(2); print(n.await()); q.put(3); print(q.get(0));"
    )
    joined.run()
    assert joined.printed == ["2", "3"]
    assert joined.machines[0].agents["r0"].block.w[layout.W_OWNER] == 0


@pytest.mark.parametrize(("seconds", "ends"), [("2.0", 2.0), ("0.0", 0.0), ("-1.0", 0.0)])
def test_the_time_limit_is_thrown_once_the_monitor_is_free(seconds: str, ends: float) -> None:
    joined = team(
        f"real t = now(); try {{ q.soon({seconds}); }} catch (TimeLimitException e)"
        ' { print(e.source() + " " + f2s(now() - t, 1)); } q.keep(0.1); print("free");'
    )
    joined.run()
    assert joined.printed == [f"r0 {ends:.1f}", "free"]


def test_a_timed_out_thread_waits_for_the_holder_of_the_monitor() -> None:
    joined = team(
        "real t = now(); future<int> s = async q.soon(1.0); future<void> k = async q.keep(3.0);"
        "try { s.await(); } catch (TimeLimitException e) { print(f2s(now() - t, 1)); } k.await();"
        'print("free");'
    )
    joined.run()
    assert joined.printed == ["3.0", "free"]


@pytest.mark.parametrize(
    ("call", "exception"),
    [("q.soon(1e308 * 10.0 * 0.0)", "ArithmeticException"), ("q.fails()", "IndexException")],
    ids=["limit of NaN", "condition throws"],
)
def test_an_exception_of_a_wait_leaves_the_monitor_free(call: str, exception: str) -> None:
    joined = team(
        f'try {{ {call}; }} catch ({exception} e) {{ print("caught"); }} q.put(1); print(q.get(0));'
    )
    joined.run()
    assert joined.printed == ["caught", "1"]


def test_a_cancelled_wait_throws_while_it_holds_the_monitor() -> None:
    joined = team(
        "future<int> g = async q.get(0); sleep(1.0); g.cancel();"
        'try { g.await(); } catch (CancelledException e) { print("cancelled"); } q.put(1); print(q.get(0));'
    )
    joined.run()
    assert joined.printed == ["cancelled", "1"]
    assert joined.machines[0].agents["r0"].monitor_waits == {}


def test_a_cancelled_call_ends_after_the_holder_has_left_the_monitor() -> None:
    joined = team(
        "real t = now(); future<int> g = async q.get(0); future<void> k = async q.keep(3.0); sleep(1.0);"
        "g.cancel(); print(f2s(now() - t, 1)); k.await();"
    )
    joined.run()
    assert joined.printed == ["3.0"]


def test_a_condition_that_reads_the_clock_is_checked_regularly() -> None:
    joined = team("real t = now(); q.late(t + 1.0); print(now() - t < 1.01);")
    joined.run()
    assert joined.printed == ["true"]
