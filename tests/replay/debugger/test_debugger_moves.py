"""Moves of the debugger through a recorded team, in both directions."""

from __future__ import annotations

import pytest

from lfield.errors import UsageError
from lfield.replay.debugger.debugger import Breakpoint, Debugger
from lfield.replay.debugger.expressions import ValueUnknown, WatchExpression
from lfield.replay.debugger.moment import Phase
from lfield.replay.debugger.targets import AnyTarget, StatementTarget
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.replay.host_replay import HostReplay

#: Lines of examples/01-first-flight/mission.L.
LEG, TOGETHER, FLY, OBSERVE, RETURN = 87, 89, 21, 37, 24


def _line(debugger):
    return debugger.stack()[0].line.line


def test_breakpoints_stop_in_both_directions(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    legs = []
    while debugger.resume():
        legs.append(debugger.evaluate("leg")[0])
    assert legs == [0, 1, 2]
    debugger.go_to(debugger.team.end)
    while debugger.resume(backward=True):
        legs.append(debugger.evaluate("leg")[0])
    assert legs == [0, 1, 2, 2, 1, 0]


def test_a_condition_of_a_breakpoint_is_evaluated_in_its_frame(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG, WatchExpression("leg == 1 && step > 3.0")))
    assert debugger.resume()
    assert debugger.evaluate("leg")[0] == 1
    assert not debugger.resume()


def test_a_step_over_stays_in_the_frame_in_both_directions(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    debugger.resume()
    lines = [_line(debugger)]
    for _ in range(4):
        assert debugger.step_over()
        lines.append(_line(debugger))
    assert lines == [LEG, LEG + 1, TOGETHER, TOGETHER + 1, TOGETHER + 2]
    for _ in range(4):
        assert debugger.step_over(backward=True)
    assert _line(debugger) == LEG


@pytest.mark.few(0)
@pytest.mark.parametrize("move", [Debugger.step_line, Debugger.step_over])
def test_steps_by_line_stop_at_the_same_places_in_both_directions(debugger, move):
    debugger.enter()
    found = [debugger.place]
    while len(found) < 60 and move(debugger):
        found.append(debugger.place)
    assert len(found) > 20
    back = [found[-1]]
    while len(back) < len(found) and move(debugger, backward=True):
        back.append(debugger.place)
    assert back == found[::-1]


def test_a_step_backward_from_within_a_line_goes_to_its_start(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    assert debugger.resume()
    while True:
        place, top = debugger.place, debugger.stack()[0]
        assert debugger.step()
        now = debugger.stack()[0]
        if (now.line, now.depth, now.key) == (top.line, top.depth, top.key):
            break
    assert debugger.step_over(backward=True)
    assert debugger.place == place


def test_a_step_follows_the_coordinator_to_another_host(debugger):
    debugger.search(StatementTarget("pilot"))
    hosts = [debugger.host]
    while debugger.step_line() and debugger.seconds < 10.0:
        hosts.append(debugger.host)
    assert {"alpha", "bravo"} <= set(hosts)


def test_a_step_out_of_a_method_reaches_its_caller(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", OBSERVE))
    assert debugger.resume()
    assert [frame.method for frame in debugger.stack()][:2] == ["Copter.observe", "Copter.takeoff"]
    assert debugger.step_out()
    assert debugger.stack()[0].method != "Copter.observe"


def test_a_step_out_of_the_outermost_frame_searches_nothing(debugger, monkeypatch):
    debugger.enter()
    assert [frame.method for frame in debugger.stack()] == ["FirstFlight.init"]
    monkeypatch.setattr(TeamTimeline, "find", None)
    assert not debugger.step_out()
    assert not debugger.step_out(backward=True)


def test_searches_find_portals_hops_devices_and_events(debugger):
    assert debugger.search(debugger.portal_target())
    assert debugger.stack()[0].method == "Copter.takeoff"
    assert debugger.search(debugger.hop_target("pilot"))
    assert debugger.moment.phase is Phase.INPUT
    assert debugger.focus.agent == "pilot"
    assert debugger.search(debugger.device_target())
    assert debugger.moment.phase is Phase.END
    assert debugger.stack()[0].method.startswith("Copter.")
    assert debugger.search(debugger.event_target(["printed"]))
    assert not debugger.search(debugger.event_target(["latched"]))


@pytest.mark.few(0)
def test_every_hop_is_found_in_both_directions(debugger):
    forward = []
    while debugger.search(debugger.hop_target()):
        forward.append(debugger.place[:2])
    assert len(forward) == 11
    debugger.go_to(debugger.team.end)
    backward = []
    while debugger.search(debugger.hop_target(), backward=True):
        backward.append(debugger.place[:2])
    assert backward == forward[::-1]


def test_a_condition_on_a_device_reading_is_found_where_it_becomes_true(debugger):
    assert debugger.search(debugger.condition_target("lead.fc.battery < 0.98"))
    assert debugger.evaluate("lead.battery < 0.98")[0] is True
    place = debugger.place
    debugger.go_to(debugger.team.end)
    assert debugger.search(debugger.condition_target("lead.fc.battery < 0.98"), backward=True)
    assert debugger.place == place


def test_changes_of_a_variable_are_found(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    debugger.resume()
    debugger.choose(debugger.find_thread("pilot").key)
    assert debugger.search(debugger.change_target("leg"))
    assert debugger.evaluate("leg")[0] == 1
    assert debugger.search(debugger.change_target("leg"))
    assert debugger.search(debugger.change_target("leg"), backward=True)
    assert debugger.evaluate("leg")[0] == 1


def places(debugger, target, *, backward):
    """All places that a target finds from one end of the recordings to the other."""
    debugger.go_to(debugger.team.end if backward else debugger.team.start)
    found = []
    while debugger.search(target(), backward=backward):
        found.append(debugger.place)
    return found


@pytest.mark.few(0)
def test_an_assigned_object_is_a_change_at_any_address(debugger):
    debugger.enter()
    found = places(debugger, lambda: debugger.change_target("first"), backward=False)
    heights = []
    for place in found:
        debugger.go_to(place)
        # A hop and a record drop values that are no longer read: they are null.
        if debugger.evaluate("first")[0] is not None:
            heights.append(debugger.evaluate("first.height")[0])
    assert len(heights) == len(set(heights)) == 4
    assert places(debugger, lambda: debugger.change_target("first"), backward=True) == found[::-1]


@pytest.mark.few(0)
def test_a_hop_is_neither_a_change_of_a_value_nor_of_a_condition(debugger):
    debugger.enter()
    found = places(debugger, lambda: debugger.change_target("leg"), backward=False)
    assert len(found) == 3
    assert places(debugger, lambda: debugger.condition_target("leg == 1"), backward=False) == found[:1]
    assert places(debugger, lambda: debugger.condition_target("leg == 1"), backward=True) == found[:1]


@pytest.mark.few(0)
def test_a_coordinator_is_followed_after_the_end_of_its_portal_thread(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", FLY))
    assert debugger.resume()
    assert debugger.focus.agent != "pilot"
    assert debugger.evaluate("height")[0] > 0.0
    debugger.search(debugger.event_target(["finished"]), backward=False)
    debugger.search(debugger.hop_target(), backward=True)
    debugger.choose(debugger.focus._replace(agent="lead", thread=999))
    assert debugger.stack()[0].method == "FirstFlight.init"
    assert debugger.evaluate("leg")[0] == 3
    assert debugger.search(debugger.condition_target("leg == 1"), backward=True)


def test_the_events_of_a_host_are_listed_once(debugger):
    for _ in range(6):
        debugger.search(debugger.event_target())
    place = debugger.place
    found = [repr(event.what) for event in debugger.events(10)]
    assert len(found) == len(set(found)) > 3
    debugger.go_to(debugger.team.end)
    assert len(debugger.events(10)) == 10
    debugger.go_to(place)
    assert [repr(event.what) for event in debugger.events(10)] == found


def test_a_reading_of_another_host_has_its_name(debugger):
    debugger.go_to_time(13.0)
    names = {each.name for each in debugger.readings()}
    assert {"lead.fc.battery", "wing.fc.battery"} <= names
    for name in ("lead.fc.battery", "wing.fc.battery", "lead.battery", "wing.battery"):
        assert 0.9 < debugger.evaluate(name)[0] <= 1.0


@pytest.mark.parametrize(
    "target",
    [
        lambda debugger: debugger.condition_target("nosuch < 3"),
        lambda debugger: debugger.condition_target("5"),
        lambda debugger: debugger.condition_target("leg + 1"),
        lambda debugger: debugger.condition_target("f(1)"),
        lambda debugger: debugger.change_target("nosuch"),
        lambda debugger: debugger.hop_target("nosuch"),
        lambda debugger: debugger.event_target(["nosuch"]),
    ],
)
def test_a_search_for_an_unknown_name_is_refused(debugger, target):
    with pytest.raises(UsageError):
        target(debugger)


@pytest.mark.few(0)
@pytest.mark.parametrize("kind", ["event", "hop", "portal", "device"])
def test_backward_and_forward_searches_find_the_same_places(debugger, kind):
    targets = {
        "event": debugger.event_target, "hop": debugger.hop_target,
        "portal": debugger.portal_target, "device": debugger.device_target,
    }  # fmt: skip
    found = places(debugger, targets[kind], backward=False)
    assert len(found) > 3
    assert places(debugger, targets[kind], backward=True) == found[::-1]


def test_a_time_is_reached(debugger):
    debugger.go_to_time(12.5)
    assert 12.5 <= debugger.seconds < 13.0
    debugger.go_to_time(1e9)
    assert debugger.place == debugger.team.end


def test_values_have_types_and_parts(debugger):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    debugger.resume()
    frame = debugger.stack()[0]
    known = {each.name: each for each in debugger.variables(frame)}
    assert (known["leg"].type, known["leg"].value) == ("int", "0")
    assert known["leader"].type == "Copter"
    parts = {each.name: each for each in debugger.parts(frame, known["first"])}
    assert (parts["who"].type, parts["who"].value) == ("string", '"lead"')
    assert not known["leg"].has_parts


@pytest.mark.parametrize("text", ["", "1 +", "leg leg", "a = 1 = 2)"])
def test_a_mistake_in_an_expression_is_reported(debugger, text):
    with pytest.raises(UsageError):
        debugger.evaluate(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-7 % 3", -1), ("-7 / 2", -3), ("9007199254740993 / 1", 9007199254740993), ("-7.5 % 2", -1.5),
        ("7 / 2.0", 3.5), ('"a" + "b"', "ab"), ("first == null", False), ("-leg", 0), ("leg == 0.0", True),
    ],
)  # fmt: skip
def test_an_expression_has_the_value_that_the_program_computes(debugger, text, value):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    debugger.resume()
    found = debugger.evaluate(text)[0]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    "text",
    [
        "nothing", "leg.x", "1 / 0", "1.0 / 0.0", 'leg < "a"', "first.nothing", '"a" * 3', '"%s" % 1',
        "true + 1", "leg == true", "leg == first", "9223372036854775807 + 1", "!5", "leg && true", "-true",
    ],
)  # fmt: skip
def test_an_expression_without_a_value_is_reported(debugger, text):
    debugger.add_breakpoint(Breakpoint("mission.L", LEG))
    debugger.resume()
    with pytest.raises(ValueUnknown):
        debugger.evaluate(text)


def test_a_search_for_a_reading_replays_nothing(first_flight, monkeypatch):
    debugger = Debugger(first_flight)
    debugger.go_to(debugger.team.end)
    debugger.search(debugger.condition_target("lead.fc.battery < 0.98"), backward=True)
    found = debugger.place
    assert debugger.evaluate("lead.battery < 0.98")[0]
    debugger.go_to(debugger.team.start)
    target = debugger.condition_target("lead.fc.battery < 0.98")
    with monkeypatch.context() as patch:
        patch.setattr(HostReplay, "_replay", None)
        assert debugger.team.find(target, debugger.place) == found
    replayed = AnyTarget([target])
    assert debugger.team.find(replayed, debugger.place) == found
    assert debugger.condition_target("battery < 0.5 || leg > 1").stops is None


def test_the_changes_of_a_reading_are_found_in_both_directions(debugger):
    found = places(debugger, lambda: debugger.change_target("wing.fc.position"), backward=False)
    assert len(found) > 3
    assert places(debugger, lambda: debugger.change_target("wing.fc.position"), backward=True) == found[::-1]


def test_debugging_starts_at_a_coordinator_and_finds_its_last_statement(debugger):
    assert debugger.enter()
    assert debugger.focus.agent == "pilot"
    debugger.go_to(debugger.team.end)
    assert debugger.stack() == []
    assert debugger.step(backward=True)
    assert debugger.focus.agent == "pilot"
    assert debugger.stack()[-1].method == "FirstFlight.init"
