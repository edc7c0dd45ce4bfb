"""The state of this operator's orders while they are valid."""

from __future__ import annotations

import pytest
from dashboard_script import ScriptedHost, inventory

from lfield.errors import AddressError, NoListener
from lfield.operator.team_model.team_state import OrderState
from lfield.operator.team_model.team_view import TeamView
from lfield.wire.events import DeviceLatched, EmergencyStopChanged, PauseChanged, SafeStateConfirmed
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.order_messages import OrderKind

NO_LISTENER = NoListener("alpha:8181")
BOTH = ("alpha", "beta")


class Desk:
    """A picture of two hosts, and an operator who gives orders."""

    def __init__(self) -> None:
        self.picture = TeamView(inventory())
        self.hosts = {"alpha": ScriptedHost(), "beta": ScriptedHost(8)}
        self.now = 100.0

    def tell(self, host: str, *whats: object) -> None:
        self.now += 1.0
        self.picture.feed(host, self.hosts[host].batch(self.now, *whats), self.now, 0.0)  # type: ignore[arg-type]

    def order(self, order: OrderKind, **answers: EmergencyStopResult | AddressError) -> int:
        self.now += 1.0
        number = self.picture.on_order(order, BOTH, self.now)
        for host, answer in answers.items():
            self.picture.on_answer(number, host, answer)
        return number

    @property
    def seen(self):  # type: ignore[no-untyped-def]
        return self.picture.snapshot(self.now)

    @property
    def last(self) -> OrderState:
        return self.seen.orders[-1]


def test_a_stop_without_any_answer_names_each_host_until_it_has_stopped() -> None:
    desk = Desk()
    desk.order("stop", alpha=NO_LISTENER, beta=NO_LISTENER)
    assert desk.seen.stop.unreached == {"alpha": str(NO_LISTENER), "beta": str(NO_LISTENER)}
    assert not desk.seen.stop.is_active
    desk.now += 3600.0
    assert desk.last.age == 3600.0
    desk.tell("alpha")
    assert (
        desk.seen.stop.unreached["alpha"] == "it is linked again and has not executed the order: press again"
    )
    desk.tell("alpha", EmergencyStopChanged("bob", "a child"))
    assert (desk.seen.stop.hosts, set(desk.seen.stop.unreached)) == (("alpha",), {"beta"})
    desk.tell("alpha", EmergencyStopChanged("bob", "", True))
    assert desk.seen.stop.unreached == {}, "somebody has lifted it"
    assert desk.seen.orders == ()


@pytest.mark.parametrize("order", ["pause", "resume", "lift"])
def test_an_order_without_any_answer_names_its_unreached_hosts(order: OrderKind) -> None:
    desk = Desk()
    desk.order(order, alpha=NO_LISTENER, beta=NO_LISTENER)
    assert (desk.last.order, set(desk.last.unreached)) == (order, {"alpha", "beta"})


def test_hosts_without_an_answer_are_listed_as_asked() -> None:
    desk = Desk()
    desk.tell("beta")
    number = desk.order("stop", alpha=NO_LISTENER)
    assert (desk.last.pending, set(desk.seen.stop.unreached)) == (("beta",), {"alpha"})
    desk.picture.on_answer(number, "beta", EmergencyStopResult({"two.fc": ""}))
    desk.tell("beta", EmergencyStopChanged("anna", "x"))
    assert (desk.last.pending, desk.last.done) == ((), ("beta",))


def test_a_stop_is_incomplete_until_each_host_has_answered() -> None:
    desk = Desk()
    number = desk.order("stop")
    desk.tell(
        "alpha",
        EmergencyStopChanged("anna", "x"),
        DeviceLatched("one.fc", "land", "x"),
        SafeStateConfirmed("one.fc", "land", "x"),
    )
    desk.picture.on_answer(number, "alpha", EmergencyStopResult({"one.fc": ""}))
    # beta hangs: still linked, then unlinked, and at last without an open request.
    assert (desk.seen.stop.pending, desk.seen.stop.is_complete) == (("beta",), False)
    desk.picture.on_unlinked("beta", "nothing was heard of it for 6 s")
    assert (desk.seen.stop.pending, desk.seen.stop.is_complete) == (("beta",), False)
    desk.picture.on_answer(number, "beta", NO_LISTENER)
    assert (desk.seen.stop.pending, set(desk.seen.stop.unreached)) == ((), {"beta"})
    assert not desk.seen.stop.is_complete


def test_stop_events_without_an_answer_do_not_count_as_an_answer() -> None:
    desk = Desk()
    number = desk.order("stop")
    for host, device in (("alpha", "one.fc"), ("beta", "two.fc")):
        desk.tell(
            host,
            EmergencyStopChanged("anna", "x"),
            DeviceLatched(device, "land", "x"),
            SafeStateConfirmed(device, "land", "x"),
        )
    desk.picture.on_answer(number, "alpha", EmergencyStopResult({"one.fc": ""}))
    assert (desk.last.pending, desk.seen.stop.is_complete) == (("beta",), False)
    desk.picture.on_answer(
        number, "beta", EmergencyStopResult({"two.fc": "", "two.winch": "it does not answer"})
    )
    assert desk.seen.stop.unconfirmed == {"two.winch": "it does not answer"}
    assert not desk.seen.stop.is_complete
    desk.tell("beta", DeviceLatched("two.winch", "hold", "x"), SafeStateConfirmed("two.winch", "hold", "x"))
    assert desk.seen.stop.is_complete


def test_a_host_with_an_unknown_address_counts_as_unreached() -> None:
    desk = Desk()
    desk.picture.on_answer(desk.picture.on_order("stop", ["alpha"], desk.now), "alpha", NO_LISTENER)
    assert "its address is unknown" in desk.seen.stop.unreached["beta"]


def test_an_answer_to_a_replaced_order_changes_nothing() -> None:
    desk = Desk()
    old = desk.order("stop")
    desk.order("lift", alpha=NO_LISTENER)
    desk.picture.on_answer(old, "beta", NO_LISTENER)
    assert [(order.order, order.pending) for order in desk.seen.orders] == [("lift", ("beta",))]


def test_a_lift_ends_the_stop_and_keeps_the_last_state_of_a_dead_host() -> None:
    desk = Desk()
    for host, device in (("alpha", "one.fc"), ("beta", "two.fc")):
        desk.tell(
            host,
            EmergencyStopChanged("anna", "x"),
            DeviceLatched(device, "land", "x"),
            SafeStateConfirmed(device, "land", "x"),
        )
    desk.picture.on_unlinked("beta", "the connection was lost")
    assert desk.seen.stop.confirmed == ("one.fc",)
    desk.order("lift", alpha=EmergencyStopResult({}), beta=NO_LISTENER)
    desk.tell("alpha", EmergencyStopChanged("anna", "", True))
    stop = desk.seen.stop
    assert (stop.is_active, stop.confirmed, stop.unreached) == (False, (), {})
    assert stop.stopped_before == {"beta": ("two.fc",)}
    assert (desk.last.done, desk.last.unreached) == (("alpha",), {"beta": str(NO_LISTENER)})


def test_unconfirmed_devices_of_a_dead_host_are_shown_until_the_lift() -> None:
    desk = Desk()
    desk.tell("alpha", EmergencyStopChanged("anna", "x"))
    desk.tell("beta", EmergencyStopChanged("anna", "x"), DeviceLatched("two.fc", "land", "x"))
    desk.picture.on_unlinked("beta", "the connection was lost")
    stop = desk.seen.stop
    assert stop.unconfirmed["two.fc"] == "its safe state is not confirmed yet"
    assert stop.stopped_before == {"beta": ()}
    desk.tell("alpha", EmergencyStopChanged("anna", "", True))
    assert desk.seen.stop.unconfirmed == {}


def test_a_stop_and_a_pause_are_shown_at_once() -> None:
    desk = Desk()
    desk.order(
        "pause", alpha=EmergencyStopResult({"one.fc": "its port is gone"}, "no disk"), beta=NO_LISTENER
    )
    desk.order("stop", alpha=NO_LISTENER, beta=NO_LISTENER)
    assert [order.order for order in desk.seen.orders] == ["pause", "stop"]
    assert desk.seen.orders[0].unconfirmed == {"one.fc": "its port is gone"}
    assert desk.seen.orders[0].warnings == {"alpha": "no disk"}
    desk.tell("alpha", PauseChanged("bob", True))
    assert [order.order for order in desk.seen.orders] == ["stop"]
