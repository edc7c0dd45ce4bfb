"""A host's view of its team: candidates, ages of values, and agents that cannot be called."""

from __future__ import annotations

import pytest
from directory_team import AGENTS, REGISTRY, SPAN, Seat

from lfield.capability.directory.agent_directory import ANSWER_REUSE_SECONDS
from lfield.capability.directory.agent_profile import location_of
from lfield.capability.directory.directory_delta import AgentCondition, ReservedBy, Unavailability
from lfield.capability.model import Attribute
from lfield.capability.offer import Candidate, Fact
from lfield.host.directory_updates.directory_codec import DirectoryCodec


@pytest.fixture
def seats():
    """alpha and bravo, linked, with unrelated clocks."""
    alpha, bravo = Seat("alpha"), Seat("bravo", life=7)
    bravo.clock.advance(5000.0)
    alpha.receive("bravo")
    alpha.directory.on_link_up("bravo", 7)
    return alpha, bravo


def deliver(sender, receiver, news):
    """Send a delta over a link: times become ages on the way (fleet/reports.py does it for messages)."""
    reports = DirectoryCodec(REGISTRY, AGENTS)
    report = reports.encode(news, sender.clock.monotonic())
    receiver.receive("bravo")
    receiver.directory.on_delta("bravo", reports.decode("bravo", report, receiver.clock.monotonic()))


def test_candidates_of_a_type_are_in_deployment_order(seats):
    alpha, _ = seats
    found = alpha.directory.candidates("Arm")
    assert [(c.agent, c.type, c.host, c.hops) for c in found] == [
        ("arm1", "Arm", "alpha", 0),
        ("arm2", "Arm", "bravo", 1),
        ("arm3", "Arm", "alpha", 0),
    ]
    assert alpha.directory.candidates("Visitor") == alpha.directory.candidates("Nobody") == []


def test_stated_attributes_never_age(seats):
    alpha, _ = seats
    alpha.clock.advance(1000.0)
    fact = alpha.candidate("arm2").stated["payload"]
    assert (fact.value, fact.age) == (1.2, 0.0)
    assert (alpha.candidate("rover2").stated["battery"].value, alpha.candidate("rover2").unknown) == (1.0, {})


def test_own_values_are_as_old_as_their_samples(seats):
    alpha, _ = seats
    alpha.directory.set_own("arm1", AgentCondition(samples={"battery": alpha.sample(0.5, age=0.25)}))
    alpha.clock.advance(2.0)
    arm = alpha.candidate("arm1")
    assert (arm.facts["battery"].value, arm.facts["battery"].age, arm.refusal) == (0.5, 2.25, "")


def test_candidates_are_reused_until_a_change(seats):
    alpha, bravo = seats
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8)}))
    deliver(bravo, alpha, bravo.directory.next_delta())
    first, shelf = alpha.candidate("rover1"), alpha.candidate("shelf")
    alpha.clock.advance(ANSWER_REUSE_SECONDS / 2)
    assert alpha.candidate("rover1") is first
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.7)}))
    deliver(bravo, alpha, bravo.directory.next_delta())
    changed = alpha.candidate("rover1")
    assert changed.facts["battery"].value == 0.7
    alpha.wires.down_since["bravo"] = alpha.clock.monotonic()
    assert alpha.candidate("rover1").refusal == alpha.candidate("shelf").refusal == "unreachable for 0.0 s"
    del alpha.wires.down_since["bravo"]
    alpha.clock.advance(ANSWER_REUSE_SECONDS)
    assert alpha.candidate("rover1").facts["battery"].age > changed.facts["battery"].age
    assert alpha.candidate("shelf") == shelf
    still = alpha.candidate("shelf")
    alpha.clock.advance(1000.0)
    assert alpha.candidate("shelf") is still


def test_unreported_value_is_unknown_with_a_reason(seats):
    alpha, _ = seats
    assert alpha.candidate("rover1").unknown == {"battery": "bravo has not reported battery yet"}
    alpha.directory.set_own("arm1", AgentCondition(unknown={"mode": "fc has not reported mode"}))
    unknown = alpha.candidate("arm1").unknown
    assert unknown["mode"] == "fc has not reported mode"
    assert unknown["battery"] == "alpha has not reported battery yet"


def test_remote_value_ages_only_without_messages(seats):
    alpha, bravo = seats
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8, age=0.5)}))
    deliver(bravo, alpha, bravo.directory.next_delta())
    assert alpha.candidate("rover1").facts["battery"].age == 0.5
    alpha.clock.advance(2.0)
    assert alpha.candidate("rover1").facts["battery"].age == 2.5
    alpha.clock.advance(1.0)
    alpha.receive("bravo")
    assert alpha.candidate("rover1").facts["battery"].age == 0.5


def test_value_that_its_host_does_not_renew_ages(seats):
    alpha, bravo = seats
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8)}))
    deliver(bravo, alpha, bravo.directory.next_delta())
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8, age=4.9)}))
    assert bravo.directory.next_delta() is None
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8, age=5.1)}))
    deliver(bravo, alpha, bravo.directory.next_delta())
    bravo.clock.advance(1.0)
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8, age=6.1)}))
    assert bravo.directory.next_delta() is None
    alpha.clock.advance(20.0)
    alpha.receive("bravo")
    assert alpha.candidate("rover1").facts["battery"].age == pytest.approx(25.1)


def test_only_significant_changes_are_reported(seats):
    _, bravo = seats
    for value, is_reported in [(0.800, True), (0.804, False), (0.796, False), (0.806, True), (0.802, False)]:
        bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(value)}))
        assert (bravo.directory.next_delta() is not None) == is_reported, value
    bravo.directory.set_own("arm2", AgentCondition(samples={"steps": bravo.sample(1)}))
    delta = bravo.directory.next_delta()
    assert list(delta.agents) == ["arm2"]
    bravo.directory.set_own(
        "arm2", AgentCondition(samples={"steps": bravo.sample(2), "mode": bravo.sample("hold")})
    )
    delta = bravo.directory.next_delta()
    assert {name: s.value for name, s in delta.agents["arm2"].samples.items()} == {"steps": 2, "mode": "hold"}
    assert bravo.directory.next_delta() is None


def test_refusal_states_the_reason_and_its_age(seats):
    alpha, bravo = seats
    alpha.directory.set_own("arm1", AgentCondition(Unavailability("died of DeviceException: no")))
    assert alpha.candidate("arm1").refusal == "died of DeviceException: no"
    bravo.directory.set_own(
        "arm2", AgentCondition(Unavailability("axis: no message", bravo.clock.monotonic() - 3.2))
    )
    deliver(bravo, alpha, bravo.directory.next_delta())
    assert alpha.candidate("arm2").refusal == "axis: no message for 3.2 s"
    alpha.clock.advance(60.0)
    assert alpha.candidate("arm2").refusal == "axis: no message for 63 s"
    alpha.wires.down_since["bravo"] = alpha.clock.monotonic() - 12.0
    assert alpha.candidate("arm2").refusal == "unreachable for 12 s"
    del alpha.wires.down_since["bravo"]
    bravo.directory.set_own("arm2", AgentCondition())
    deliver(bravo, alpha, bravo.directory.next_delta())
    assert alpha.candidate("arm2").refusal == ""


def test_reserved_agent_is_offered_to_its_holder_only(seats):
    alpha, bravo = seats
    bravo.directory.set_own(
        "arm2", AgentCondition(reserved=ReservedBy("pilot", bravo.clock.monotonic() - 12.0))
    )
    deliver(bravo, alpha, bravo.directory.next_delta())
    assert bravo.directory.next_delta() is None
    for seat in seats:
        assert seat.candidate("arm2").refusal == "reserved by pilot for 12 s"
        seat.directory.asker = "pilot"
        assert seat.candidate("arm2").refusal == ""
        seat.directory.asker = "rover"
        assert seat.candidate("arm2").refusal == "reserved by pilot for 12 s"
    bravo.directory.set_own("arm2", AgentCondition(reserved=ReservedBy("rover", bravo.clock.monotonic())))
    deliver(bravo, alpha, bravo.directory.next_delta())
    assert alpha.candidate("arm2").refusal == ""
    bravo.directory.set_own("arm2", AgentCondition())
    deliver(bravo, alpha, bravo.directory.next_delta())
    alpha.directory.asker = ""
    assert alpha.candidate("arm2").refusal == ""


def test_failure_is_stated_before_a_reservation(seats):
    alpha, _ = seats
    alpha.directory.set_own(
        "arm1", AgentCondition(Unavailability("died of X"), reserved=ReservedBy("pilot", 0.0))
    )
    assert alpha.candidate("arm1").refusal == "died of X"


def test_returning_host_is_synchronized_by_one_exchange(seats):
    alpha, bravo = seats
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8)}))
    bravo.directory.set_own("arm2", AgentCondition(Unavailability("fc: in its safe state hold: lost")))
    deliver(bravo, alpha, bravo.directory.next_delta())
    alpha.directory.on_link_down("bravo")
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.4)}))
    bravo.directory.set_own("arm2", AgentCondition(samples={"armed": bravo.sample(True)}))
    assert bravo.directory.next_delta() is not None
    alpha.clock.advance(30.0)
    alpha.receive("bravo")
    alpha.directory.on_link_up("bravo", 7)
    # The link is back, but the old value is not fresh.
    assert alpha.candidate("rover1").facts["battery"].age == 30.0
    deliver(bravo, alpha, bravo.directory.full_delta())
    rover, arm = alpha.candidate("rover1"), alpha.candidate("arm2")
    assert (rover.facts["battery"].value, rover.facts["battery"].age) == (0.4, 0.0)
    assert (arm.refusal, arm.facts["armed"].value) == ("", True)


def test_restarted_host_starts_without_values(seats):
    alpha, bravo = seats
    bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(0.8)}))
    late = bravo.directory.next_delta()
    deliver(bravo, alpha, late)
    again = Seat("bravo", life=8)
    alpha.directory.on_link_up("bravo", 8)
    assert alpha.candidate("rover1").unknown == {"battery": "bravo has not reported battery yet"}
    deliver(bravo, alpha, bravo.directory.full_delta())
    assert "battery" not in alpha.candidate("rover1").facts
    again.directory.set_own("rover1", AgentCondition(samples={"battery": again.sample(0.3)}))
    deliver(again, alpha, again.directory.next_delta())
    assert alpha.candidate("rover1").facts["battery"].value == 0.3


def test_delta_after_a_gap_waits_for_a_full_delta(seats):
    alpha, bravo = seats
    delta = []
    for value in (0.9, 0.8, 0.7):
        bravo.directory.set_own("rover1", AgentCondition(samples={"battery": bravo.sample(value)}))
        delta.append(bravo.directory.next_delta())
    deliver(bravo, alpha, delta[0])
    deliver(bravo, alpha, delta[2])
    assert alpha.candidate("rover1").facts["battery"].value == 0.9
    alpha.clock.advance(3.0)
    alpha.receive("bravo")
    assert alpha.candidate("rover1").facts["battery"].age == 3.0
    deliver(bravo, alpha, bravo.directory.full_delta())
    assert alpha.candidate("rover1").facts["battery"].value == 0.7


def test_host_without_live_values_sends_no_delta(seats):
    _, bravo = seats
    assert bravo.directory.next_delta() is None
    assert bravo.directory.full_delta() is None


def test_location_is_the_pose_unless_an_agent_measures_it() -> None:
    attributes = {
        "north": Attribute("north", "real", SPAN, live=True, max_age=2.0),
        "east": Attribute("east", "real", SPAN),
    }

    def at(facts, unknown):
        one = Candidate("rover", "Rover", "alpha", 0, "", facts, unknown)
        return location_of([one], attributes, (5.0, 6.0, 0.0))

    assert at({}, {}) == (5.0, 6.0, 0.0)
    assert at({}, {"north": "fc has not reported position"}) is None
    assert at({"north": Fact(1.0, 3.0, "measured"), "east": Fact(2.0)}, {}) is None
    assert at({"north": Fact(1.0, 1.0, "measured"), "east": Fact(2.0)}, {}) == (1.0, 2.0, None)
    assert location_of([], attributes, (5.0, 6.0, 0.0)) == (5.0, 6.0, 0.0)
