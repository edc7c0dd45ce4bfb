"""What is told of hops, and what led to what, one event after the other."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from lfield.clock import ManualClock
from lfield.host.sight.budget import HOPS_UNWATCHED
from lfield.host.sight.hops import Hops
from lfield.host.sight.teller import Teller
from lfield.mobility.effects import Departed, Finished, InDoubt, Supersede
from lfield.wire import events
from lfield.wire.coordinators import Known, Transfer
from lfield.wire.fields import MAX_TEXT

HASH = b"p" * 32


class Rig:
    """A host `a` without anything, whose parts tell."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.teller = Teller(self.clock)
        self.agents: dict[str, SimpleNamespace] = {}
        called = SimpleNamespace(id="gate", host=1)
        machine = SimpleNamespace(agents=self.agents, calling=lambda agent: (called, "pass"))
        team = SimpleNamespace(hosts=["a", "b"], coordinators=[SimpleNamespace(id="w")])
        self.hops = Hops(self.teller, machine, "a", team)  # type: ignore[arg-type]

    def agent(self, sequence: int, *, frozen: bool = True) -> None:
        self.agents["w"] = SimpleNamespace(id="w", generation=1, sequence=sequence, frozen=frozen)

    @property
    def told(self) -> list[events.Event]:
        return self.teller.stream.after(0, 10_000, 10**9)[0]

    @property
    def last(self) -> tuple[int, events.State | events.Thinned]:
        return self.told[-1].cause, self.told[-1].what


@pytest.fixture
def rig() -> Rig:
    return Rig()


def header(sequence: int) -> Transfer:
    return Transfer("w", 1, sequence, 3, HASH, 7, 544)


def test_a_hop_leaves_is_sent_again_and_arrives(rig: Rig) -> None:
    rig.agent(4)
    rig.hops.left("b", header(4))
    rig.clock.advance(0.5)
    rig.hops.left("b", header(4))
    rig.clock.advance(0.25)
    rig.hops.departed(Departed("w", 1, 4, "b"))
    left, hopped = rig.told
    assert left.what == events.Left("w", 1, 4, "b", "gate", "pass", 544)
    assert hopped.what == events.Hopped("w", 1, 4, "b", 0.75)
    assert hopped.cause == left.number


def test_a_hop_that_an_earlier_life_has_sent_took_nobody_knows_how_long(rig: Rig) -> None:
    rig.hops.is_away(Known("w", 1, 9, 8, "PREPARED", "b"))
    rig.hops.departed(Departed("w", 1, 9, "b"))
    assert rig.last == (0, events.Hopped("w", 1, 9, "b", None))


def test_who_comes_back_before_it_was_confirmed_has_confirmed_it(rig: Rig) -> None:
    rig.agent(4)
    rig.hops.left("b", header(4))
    rig.clock.advance(0.5)
    rig.hops.arrives("b", header(5))
    rig.clock.advance(0.25)
    rig.agent(5)
    rig.hops.goes("w", 1)
    left, hopped, came = rig.told
    assert (hopped.cause, hopped.what) == (left.number, events.Hopped("w", 1, 4, "b", 0.5))
    assert came.what == events.Came("w", 1, 5, "b", 544)
    rig.hops.departed(Departed("w", 1, 4, "b"))
    assert len(rig.told) == 3


def test_what_ends_elsewhere_before_it_was_confirmed_has_confirmed_it(rig: Rig) -> None:
    rig.agent(4)
    rig.hops.left("b", header(4))
    rig.clock.advance(0.5)
    rig.hops.tell(Finished("w", 1, "done", "", "b"))
    assert rig.last == (1, events.Hopped("w", 1, 4, "b", 0.5))


@pytest.mark.parametrize("outcome", ["stays", "lost", "superseded"])
def test_a_hop_that_came_to_nothing_is_confirmed_by_nothing_later(rig: Rig, outcome: str) -> None:
    rig.agent(4)
    rig.hops.left("b", header(4))
    if outcome == "stays":
        rig.hops.stays(rig.agents["w"], "UnreachableResourceException", "", recovered=False)  # type: ignore[arg-type]
    else:
        rig.hops.tell(Finished("w", 1, outcome, "", "b"))  # type: ignore[arg-type]
    rig.hops.arrives("b", header(7))
    rig.agent(7)
    rig.hops.goes("w", 1)
    assert "hopped" not in [event.kind for event in rig.told]


def test_a_hop_that_was_not_told_is_not_heard_of(rig: Rig) -> None:
    most = int(HOPS_UNWATCHED.burst)
    for n in range(most + 5):
        rig.hops.left("b", header(n))
        rig.hops.departed(Departed("w", 1, n, "b"))
    assert len(rig.told) == 2 * most
    rig.clock.advance(1.0)
    rig.teller.settle()
    assert rig.last == (0, events.Skipped("left", 5))


def test_what_came_and_was_refused_has_not_come(rig: Rig) -> None:
    rig.hops.arrives("b", header(5))
    rig.agent(7)
    rig.hops.goes("w", 1)
    assert rig.told == []
    rig.hops.arrives("b", header(7))
    rig.hops.goes("w", 1)
    assert rig.last == (0, events.Came("w", 1, 7, "b", 544))
    rig.hops.goes("w", 1)
    assert len(rig.told) == 1


def test_of_coordinators_that_nobody_knows_nothing_is_kept(rig: Rig) -> None:
    for n in range(100):
        rig.hops.arrives("b", Transfer(f"stranger{n}", 1, 5, 3, HASH, 7, 544))
    rig.agents["stranger1"] = SimpleNamespace(id="stranger1", generation=1, sequence=5, frozen=True)
    rig.hops.goes("stranger1", 1)
    assert rig.told == []


def test_the_end_of_a_call_is_not_told_once_nobody_watches(rig: Rig) -> None:
    rig.teller.began(1, "w", "gate", "pass")
    assert rig.teller.is_told(1)
    rig.teller.forget_calls()
    rig.teller.ended(1, "done")
    assert len(rig.told) == 1


def test_what_it_does_next_is_caused_by_its_coming_and_not_by_what_it_did_before_it_left(rig: Rig) -> None:
    rig.teller.started("w", 1)
    rig.agent(2)
    rig.hops.arrives("b", header(2))
    rig.hops.goes("w", 1)
    rig.teller.printed("w", "here")
    assert [event.cause for event in rig.told] == [0, 0, 2]


def test_doubts_ends_and_later_starts_are_told_once_and_where_they_are(rig: Rig) -> None:
    rig.hops.tell(InDoubt("w", 1, 2, "b", "no answer"))
    rig.hops.tell(Supersede("w", 1, "another start"))
    rig.hops.tell(Finished("w", 1, "done", "", "b"))
    assert [event.what for event in rig.told] == [events.Doubted("w", 1, "b", "no answer")]
    rig.agent(2)
    rig.hops.tell(Supersede("w", 1, "another start"))
    rig.hops.tell(Finished("w", 1, "lost", "given up", "a"))
    assert [event.what for event in rig.told[1:]] == [
        events.Superseded("w", 1, "another start"),
        events.Finished("w", 1, "lost", "given up"),
    ]


def test_calls_of_one_resource_have_a_chain_each(rig: Rig) -> None:
    teller = rig.teller
    teller.began(1, "w", "gate", "pass")
    teller.began(2, "v", "gate", "pass")
    teller.asked("gate", 10, 1, "gate.fc", "goTo")
    teller.asked("gate", 11, 2, "gate.fc", "land")
    teller.answered("gate", 10, "")
    teller.answered("gate", 11, "gate.fc: too far")
    teller.ended(2, "thrown", "DeviceException")
    teller.ended(1, "done")
    causes = [event.cause for event in rig.told]
    assert causes == [0, 0, 1, 2, 3, 4, 6, 5]
    assert rig.told[5].what == events.Answered(2, "gate", "gate.fc", "land", 0.0, "gate.fc: too far")


def test_calls_that_are_under_way_when_a_resource_dies_are_lost(rig: Rig) -> None:
    rig.teller.began(1, "w", "gate", "pass")
    rig.teller.began(2, "v", "other", "pass")
    rig.teller.resource_died("gate", "NullException")
    rig.teller.ended(1, "done")
    assert rig.last == (1, events.Ended(1, "w", "gate", "pass", 0.0, "lost", "NullException"))


def test_a_device_goes_safe_because_of_what_has_the_same_reason(rig: Rig) -> None:
    teller = rig.teller
    teller.logged("up")
    teller.stopped("anna", "fire", lifted=False)
    teller.device(events.Latched("g.fc", "land", "fire"))
    teller.device(events.Confirmed("g.fc", "land", "fire"))
    teller.device(events.Latched("h.fc", "land", "it was lost"))
    assert [event.cause for event in rig.told] == [0, 0, 2, 3, 0]


def test_what_a_device_still_does_is_told_once_a_second_and_its_rest_at_once(rig: Rig) -> None:
    for _ in range(30):
        rig.teller.device(events.Moving("g.fc", "falls"))
        rig.clock.advance(0.1)
    rig.teller.device(events.Moving("g.fc", ""))
    rig.teller.device(events.Moving("g.fc", ""))
    assert [event.what.moving for event in rig.told] == ["falls"] * 3 + [""]  # type: ignore[union-attr]


def test_many_reasons_are_not_kept_for_ever(rig: Rig) -> None:
    for n in range(200):
        rig.teller.stopped("anna", f"reason {n}", lifted=False)
    rig.teller.device(events.Latched("g.fc", "land", "reason 1"))
    rig.teller.device(events.Latched("h.fc", "land", "reason 199"))
    assert [event.cause for event in rig.told[-2:]] == [0, 200]


def test_long_texts_are_cut_to_what_a_message_carries(rig: Rig) -> None:
    long = "x" * (2 * MAX_TEXT)
    rig.teller.logged(long)
    rig.teller.stopped(long, long, lifted=False)
    rig.teller.device(events.Latched("g.fc", "land", rig.told[-1].what.reason))  # type: ignore[union-attr]
    assert all(len(event.what.text) <= MAX_TEXT for event in rig.told[:1])  # type: ignore[union-attr]
    assert rig.told[-1].cause == 2
