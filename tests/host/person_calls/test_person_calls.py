"""Portal calls of persons on a simulated host: once each, within the access rules, with time limits."""

from __future__ import annotations

from pathlib import Path

import pytest
from calling_person import CallingPerson, fleet_of, log_of

from lfield.host.inputs import AgentsHalt
from lfield.host.person_calls import person_calls
from lfield.host.person_calls.call_limits import RUNNING_OF_ONE
from lfield.vm.person_calls.l_object import LObject

PROGRAM = """
class Place {
    public real x;
    public Place(real at) { x = at; }
}
resource Post {
    int count;
    init(string[] arg) { sleep(0.1); }
    portal add(int n) emit int { count = count + n; return count; }
    portal add(real n) emit string { return "real"; }
    portal mix(string a, real[] b, Place c, boolean d) emit Place {
        Place made = new Place(b[0] + c.x);
        print(a);
        return made;
    }
    portal wait(real seconds) emit int {
        try { sleep(seconds); }
        catch (CancelledException e) { print("cancelled: " + e.message()); throw e; }
        count = count + 1;
        return count;
    }
    portal fail() { int[] none = new int[1]; none[2] = 1; }
    portal long(int n) emit string[] {
        string[] all = new string[n];
        for (int i = 0; i < n; i = i + 1) all[i] = "0123456789012345678901234567890123456789";
        return all;
    }
}
resource Other { init(string[] arg) { } portal there() { } }
coordinator Idle { init(string[] arg) { sleep(10000.0); } }
"""
DEPLOYMENT = "//Post:post@alpha\n//Other:other@bravo\n//Idle:idle@alpha\n"


@pytest.fixture
def fleet(tmp_path: Path):
    return fleet_of(tmp_path, PROGRAM, DEPLOYMENT)


def test_values_are_passed_and_returned_and_the_log_names_the_caller(fleet) -> None:
    anna = CallingPerson(fleet)
    assert anna.value("add", 2) == 2
    assert anna.value("add", 2.0) == "real"
    assert anna.value("mix", "é", [1, 2.5], LObject("Place", x=0.5), True) == LObject("Place", x=1.5)
    log = log_of(fleet)
    assert "post.mix() called by person anna" in log
    assert "post.mix() called by person anna ended: returned" in log


def test_an_exception_of_the_portal_is_the_result(fleet) -> None:
    found = CallingPerson(fleet).result("fail")
    assert (found.outcome, found.kind) == ("thrown", "IndexException")


def test_a_repeated_call_is_executed_once_and_answered_each_time(fleet) -> None:
    anna = CallingPerson(fleet)
    order = anna.call("wait", 1.0)
    fleet.run(0.5)
    anna.enter(order)
    fleet.run(1.5)
    anna.enter(order)
    fleet.run(1.0)
    assert [found.outcome for found in anna.results] == ["returned", "returned"]
    assert anna.value("add", 0) == 1
    bob = CallingPerson(fleet, "bob")
    bob.enter(order)
    fleet.run(1.0)
    assert [found.kind for found in bob.results] == ["not-permitted"]


def test_a_call_of_an_earlier_incarnation_is_not_executed(fleet) -> None:
    anna = CallingPerson(fleet)
    found = anna.result("add", 1, incarnation=1)
    assert (found.outcome, found.kind) == ("unknown", "restarted")
    assert anna.value("add", 0) == 0


def test_ids_are_kept_longer_than_clients_repeat_them(fleet) -> None:
    anna = CallingPerson(fleet)
    order = anna.call("add", 1, limit=5.0)
    fleet.run(5.0 + person_calls.KEEP_ID - 10.0)
    anna.enter(order)
    fleet.run(1.0)
    assert len(anna.results) == 2
    assert anna.value("add", 0) == 1
    calls = fleet.runs["alpha"].core.person_calls
    fleet.run(2 * person_calls.KEEP_ID)
    assert not calls._calls


@pytest.mark.parametrize(
    ("portal", "arguments", "kind"),
    [
        ("nothing", (), "no-portal"),
        ("add", (), "arguments"),
        ("add", ("one",), "arguments"),
        ("mix", ("a", [None], None, True), "arguments"),
        ("mix", ("a", [1.0], LObject("Other"), True), "arguments"),
    ],
)
def test_a_call_without_a_matching_portal_is_refused(fleet, portal, arguments, kind) -> None:
    found = CallingPerson(fleet).result(portal, *arguments)
    assert (found.outcome, found.kind) == ("refused", kind)


def test_invalid_encoded_values_are_refused(fleet) -> None:
    anna = CallingPerson(fleet)
    for data in (b"", b"\x91", b"\xc1", b"\xa1a", b"\x91\xc4\x01a", b"\x91\xd4\x02a", b"\x91" * 5000):
        order = anna.order("add")
        anna.enter(type(order)(order.id, order.incarnation, "post", "add", data, 1.0))
        fleet.run(0.5)
        found = anna.results[-1]
        assert (found.outcome, found.kind) == ("refused", "arguments"), data


def test_agents_of_other_hosts_and_coordinators_are_refused(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, PROGRAM, DEPLOYMENT, "calls: {others: all}\n")
    anna = CallingPerson(fleet)
    for name in ("other", "idle", "nobody"):
        found = anna.result("there", resource=name)
        assert (found.outcome, found.kind) == ("refused", "no-portal")


def test_without_a_rule_every_call_is_refused(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, PROGRAM, DEPLOYMENT, "")
    for person in (CallingPerson(fleet), CallingPerson(fleet, "joe", kind="local")):
        found = person.result("add", 1)
        assert (found.outcome, found.kind) == ("refused", "not-permitted")


def test_rules_apply_per_caller_and_an_assistant_needs_its_own(tmp_path: Path) -> None:
    access = "calls:\n  anna: {post: [add]}\n  bob: {}\n  others: {Post: [wait]}\nassistants: [anna]\n"
    fleet = fleet_of(tmp_path, PROGRAM, DEPLOYMENT, access)
    anna, bob, carl = (CallingPerson(fleet, name) for name in ("anna", "bob", "carl"))
    local = CallingPerson(fleet, "joe", kind="local")
    assert anna.value("add", 1) == 1
    assert anna.result("wait", 0.1).kind == "not-permitted"
    assert bob.result("add", 1).kind == bob.result("wait", 0.1).kind == "not-permitted"
    assert carl.value("wait", 0.1) == local.value("wait", 0.1) - 1 == 2
    assert anna.value("add", 1, is_assistant=True) == 4
    assert "called by assistant of person anna" in log_of(fleet)
    assert carl.result("wait", 0.1, is_assistant=True).kind == "not-permitted"


def test_a_time_limit_cancels_the_portal(fleet) -> None:
    anna = CallingPerson(fleet)
    found = anna.result("wait", 100.0, limit=2.0)
    assert (found.outcome, found.kind) == ("thrown", "TimeLimitException")
    assert "cancelled: the time limit of 2 s has expired" in log_of(fleet)
    assert anna.value("add", 0) == 0


def test_a_cancelled_call_ends_and_a_late_one_does_not_start(fleet) -> None:
    anna = CallingPerson(fleet)
    order = anna.call("wait", 100.0)
    fleet.run(1.0)
    CallingPerson(fleet, "bob").cancel(order)
    fleet.run(1.0)
    assert not anna.results
    anna.cancel(order)
    fleet.run(1.0)
    assert [(found.outcome, found.kind) for found in anna.results] == [("thrown", "CancelledException")]
    order_after_cancel = anna.order("add", 1)
    anna.cancel(order_after_cancel)
    anna.enter(order_after_cancel)
    fleet.run(1.0)
    assert (anna.results[-1].outcome, anna.results[-1].kind) == ("refused", "cancelled")
    assert anna.value("add", 0) == 0


def test_a_pause_ends_running_calls_and_refuses_new_ones(fleet) -> None:
    anna = CallingPerson(fleet)
    anna.call("wait", 5.0)
    fleet.run(1.0)
    anna.pause()
    fleet.run(1.0)
    assert [(found.outcome, found.kind) for found in anna.results] == [("thrown", "RestartException")]
    order = anna.order("add", 1)
    anna.enter(order)
    fleet.run(1.0)
    assert (anna.results[-1].outcome, anna.results[-1].kind) == ("refused", "paused")
    anna.pause(lift=True)
    fleet.run(1.0)
    # A delayed copy of the refused call.
    anna.enter(order)
    fleet.run(1.0)
    assert anna.results[-1].kind == "paused"
    fleet.run(5.0)
    assert anna.value("add", 10) == 11


def test_a_host_that_stops_answers_running_calls_at_once(fleet) -> None:
    anna = CallingPerson(fleet)
    anna.call("wait", 100.0, limit=300.0)
    fleet.run(1.0)
    life = fleet.runs["alpha"]
    life.process.loop.enter(lambda: life.host.dispatch(AgentsHalt()))
    fleet.run(1.0)
    (found,) = anna.results
    assert (found.outcome, found.kind) == ("unknown", "stopped")
    assert "post.wait() called by person anna ended: stopped" in log_of(fleet)


def test_calls_are_limited_by_caller(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, PROGRAM, DEPLOYMENT, "calls: {others: all}\n")
    anna, bob = CallingPerson(fleet), CallingPerson(fleet, "bob")
    for _ in range(RUNNING_OF_ONE):
        anna.call("wait", 5.0)
    assert anna.result("add", 1).kind == "busy"
    assert bob.value("add", 1) == 1
    fleet.run(5.0)
    before = len(anna.results)
    for _ in range(200):
        anna.call("add", 0)
    fleet.run(5.0)
    kinds = [found.kind for found in anna.results[before:]]
    assert len(kinds) == 200
    assert kinds.count("busy") >= 100
    assert bob.value("add", 0) == 1 + RUNNING_OF_ONE
    assert anna.value("add", 0) == 1 + RUNNING_OF_ONE


def test_the_size_of_results_is_limited(fleet, monkeypatch) -> None:
    anna = CallingPerson(fleet)
    found = anna.result("long", 10000)
    assert (found.outcome, found.kind) == ("thrown", "LimitException")
    monkeypatch.setattr(person_calls, "MAX_RESULTS", 100_000)
    orders = [anna.call("long", 1000) for _ in range(4)]
    fleet.run(3.0)
    anna.enter(orders[0])
    anna.enter(orders[3])
    fleet.run(1.0)
    assert [(each.outcome, each.kind) for each in anna.results[-2:]] == [
        ("unknown", "dropped"),
        ("returned", ""),
    ]


def test_the_running_call_is_listed_with_its_caller(fleet) -> None:
    core = fleet.runs["alpha"].core
    anna = CallingPerson(fleet)
    anna.call("wait", 2.0)
    fleet.run(1.0)
    (call,) = core.machine.person_portals.running
    assert (call.agent, call.resource, call.portal) == ("person anna", "post", "wait")
    fleet.run(2.0)
    assert core.machine.person_portals.running == []
