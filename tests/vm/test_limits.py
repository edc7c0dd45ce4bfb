"""A test per limit: each ends in a LimitException that L code catches, and other agents continue."""

from __future__ import annotations

import pytest

from lfield.testing.golden import run_text
from lfield.vm.engine_interface import AgentLimits

GOOD = """
resource Good { init(string[] arg) { } portal hello() emit string { return "still here"; } }
"""

CASES = {
    "heap": (
        "Node n = null; while (true) n = new Node(n);",
        AgentLimits(heap=64 << 10),
        "the heap is over its limit",
    ),
    "call_depth": ("deeper(1);", AgentLimits(call_depth=50), "calls are nested deeper than 50"),
    "array_length": (
        "int[] a = new int[101];",
        AgentLimits(array_length=100),
        "an array of 101 is over the limit of 100",
    ),
    "string_length": (
        'string s = "0123456789"; while (true) s = s + s;',
        AgentLimits(string_length=1000),
        "a string of 1280 is over the limit of 1000",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_each_limit_raises_a_limit_exception(name: str) -> None:
    body, limits, message = CASES[name]
    desk, _ = run_text(
        GOOD
        + """
class Node { public Node next; public Node(Node n) { next = n; } }
coordinator Main {
  init(string[] arg) {
    try { burst(); } catch (LimitException e) { print(e.message()); }
    print(findGood("good").hello());
  }
  private void burst() { """
        + body
        + """ }
  private int deeper(int n) { return deeper(n + 1) + 1; }
}""",
        limits,
    )
    assert desk.output[0].startswith(message)
    assert desk.output[1] == "still here"


def test_the_number_of_threads_per_agent_is_limited() -> None:
    desk, _ = run_text(
        """
resource Slow { init(string[] arg) { } portal wait() { sleep(1.0); } }
coordinator A { init(string[] arg) { findSlow("slow").wait(); } }
coordinator B { init(string[] arg) {
    sleep(0.5);
    try { findSlow("slow").wait(); } catch (LimitException e) { print(e.message()); } } }
""",
        AgentLimits(threads=1),
    )
    assert desk.output == ["slow already serves its limit of 1 threads"]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("while (true) { }", ""),
        ("while (true) now();", ""),
        ('while (true) write("x");', ""),
        ("Node n = null; while (true) n = new Node(n);", "LimitException"),
        ("deeper(1);", "LimitException"),
    ],
)
def test_a_misbehaving_agent_does_not_starve_others(body: str, reason: str) -> None:
    desk, _ = run_text(
        GOOD
        + """
class Node { public Node next; public Node(Node n) { next = n; } }
resource Bad { init(string[] arg) { """
        + body
        + """ } private int deeper(int n) { return deeper(n + 1) + 1; } }
coordinator Main { init(string[] arg) { print(findGood("good").hello()); } }
""",
        AgentLimits(heap=64 << 10),
    )
    assert desk.output == ["still here"]
    died = [a.report for a in desk.endings if a.ended == "died"]
    assert [d.partition(":")[0] for d in died] == ([reason] if reason else [])


@pytest.mark.few(0)
def test_a_coordinator_that_only_calls_portals_does_not_starve_others() -> None:
    desk, _ = run_text(
        GOOD
        + """
coordinator Greedy { init(string[] arg) { Good g = findGood("good"); while (true) g.hello(); } }
coordinator Main { init(string[] arg) { for (int i = 0; i < 10; i = i + 1) yield(); print("done"); } }
"""
    )
    assert desk.output == ["done"]


def test_a_heap_exception_has_space_even_when_nothing_is_freed() -> None:
    desk, _ = run_text(
        """
resource Hoarder {
  int[][] kept; int n;
  init(string[] arg) { kept = new int[1000][]; }
  portal hoard() emit int {
    try { while (true) { kept[n] = new int[100]; n = n + 1; } } catch (LimitException e) { }
    try { kept[n] = new int[100]; } catch (LimitException e) { return n; }
    return -1;
  }
}
coordinator Main { init(string[] arg) { print(findHoarder("hoarder").hoard() > 10); } }
""",
        AgentLimits(heap=64 << 10),
    )
    assert desk.output == ["true"]
