"""Orders as datagrams from a desk to hosts, over a network that loses, repeats and delays them."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from order_world import AT, OrderingPerson, World, authority, keys, person

from lfield.authority.identity import Right
from lfield.authority.order_signing.order_signatures import OrderSigner, verify_order
from lfield.authority.peer_verification import RevocationList
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.wire.order_messages import (
    MAX_DATAGRAM,
    Epochs,
    OrderConfirmed,
    OrderDenied,
    SignedOrder,
    decode_datagram,
    encode_datagram,
)

TEAM = ("alpha", "bravo", "charlie", "delta", "echo")


def present(world: World, *hosts: str) -> dict[str, Epochs]:
    return {host: world.posts[host].orders.epochs for host in hosts or world.posts}


def orders_to(world: World, host: str, since: int = 0) -> list[bytes]:
    return [data for source, target, data in world.sent[since:] if target == host and source == "desk"]


def taught(world: World) -> World:
    """Give the hosts the person's certificate, as after a connection."""
    for post in world.posts.values():
        signer = OrderSigner(person())
        post.datagrams._certificates.add_der(signer.certificate)
    return world


# --- the usual case ----------------------------------------------------------------------------------


def test_an_order_with_a_present_epoch_takes_one_round_trip_of_small_datagrams():
    world = taught(World(*TEAM))
    desk = OrderingPerson(world, "stop", present(world), reason="person on the field")
    world.run(5.0)
    assert {post.executed == [("stop", "person on the field")] for post in world.posts.values()} == {True}
    confirmed = [found for found in desk.asking.results.values() if isinstance(found, OrderConfirmed)]
    assert [found.safe for found in confirmed] == [("p.fc",)] * 5
    assert desk.asking.results.keys() == set(TEAM)
    # The request, the check, the device, and the answer.
    assert desk.done_at == pytest.approx(2 * 0.01 + 0.001 + 0.05)
    assert max(len(data) for host in TEAM for data in orders_to(world, host)) <= 300
    assert [len(orders_to(world, host)) for host in TEAM] == [1] * 5


def test_without_epoch_and_certificate_an_order_takes_two_round_trips():
    world = World("alpha")
    desk = OrderingPerson(world, "stop", {"alpha": Epochs()})
    world.run(5.0)
    assert world.posts["alpha"].executed == [("stop", "fog")]
    assert desk.done_at == pytest.approx(4 * 0.01 + 0.001 + 0.05)
    assert max(len(data) for _, _, data in world.sent) <= MAX_DATAGRAM


def test_an_old_epoch_is_challenged_and_signed_again():
    world = taught(World("alpha"))
    desk = OrderingPerson(world, "pause", {"alpha": Epochs(b"o" * 8, b"o" * 8)})
    world.run(5.0)
    assert world.posts["alpha"].executed == [("pause", "")]
    assert desk.is_done
    assert desk.asking.epochs["alpha"] == world.posts["alpha"].orders.epochs


@pytest.mark.parametrize("seed", range(5))
def test_a_loss_of_half_the_datagrams_only_delays_a_stop(seed):
    world = taught(World(*TEAM, loss=0.5, seed=seed))
    desk = OrderingPerson(world, "stop", present(world))
    world.run(20.0, lambda: desk.is_done)
    assert desk.is_done
    assert all(post.executed == [("stop", "fog")] for post in world.posts.values())


def test_a_slow_device_is_announced_and_the_order_still_confirmed():
    world = taught(World("alpha"))
    world.posts["alpha"].slow = 3.0
    desk = OrderingPerson(world, "stop", present(world))
    world.run(0.2)
    assert desk.asking.received == {"alpha"}
    assert not desk.asking.results
    world.run(10.0)
    assert isinstance(desk.asking.results["alpha"], OrderConfirmed)
    assert world.posts["alpha"].executed == [("stop", "fog")]


def test_an_unreachable_host_is_reached_through_a_relay():
    world = taught(World("alpha", "bravo"))
    world.cut = {("desk", "bravo"), ("bravo", "desk")}
    desk = OrderingPerson(world, "stop", present(world))
    world.run(5.0)
    assert world.posts["bravo"].executed == [("stop", "fog")]
    assert isinstance(desk.asking.results["bravo"], OrderConfirmed)
    assert desk.asking.results.keys() == {"alpha", "bravo"}
    relayed = [data for source, target, data in world.sent if (source, target) == ("alpha", "bravo")]
    assert relayed
    assert set(relayed) <= set(orders_to(world, "alpha")), "a datagram is relayed unchanged"


def test_a_challenge_returns_through_the_relay():
    world = taught(World("alpha", "bravo"))
    world.cut = {("desk", "bravo"), ("bravo", "desk")}
    desk = OrderingPerson(world, "stop", present(world, "alpha") | {"bravo": Epochs(b"o" * 8, b"o" * 8)})
    world.run(5.0)
    assert world.posts["bravo"].executed == [("stop", "fog")]
    assert desk.is_done


def test_relayed_orders_do_not_circulate():
    world = taught(World(*TEAM))
    world.cut = {("desk", "echo"), ("echo", "desk")} | {(host, "echo") for host in TEAM}
    desk = OrderingPerson(world, "stop", present(world))
    world.run(1.0)
    desk.given_up = True
    world.run(1.0)
    world.sent.clear()
    world.run(60.0)
    assert world.sent == []
    assert world.posts["echo"].executed == []


# --- orders without effect ---------------------------------------------------------------------------


def captured(world: World, host: str) -> bytes:
    return orders_to(world, host)[0]


def test_a_stop_replayed_after_a_lift_has_no_effect():
    world = taught(World("alpha", "bravo"))
    OrderingPerson(world, "stop", present(world))
    world.run(2.0)
    stop = captured(world, "alpha")
    lift = OrderingPerson(world, "lift", present(world), name="other")
    world.run(2.0)
    assert lift.is_done
    alpha = world.posts["alpha"]
    for origin in ("desk", "attacker", "attacker"):
        alpha.came(stop, origin)
    world.run(2.0)
    assert alpha.executed == [("stop", "fog"), ("lift", "fog")]
    assert not alpha.held["stop"]


def test_a_replayed_stop_that_is_new_to_a_host_is_only_challenged():
    world = taught(World("alpha", "bravo"))
    world.cut = {("desk", "bravo"), ("alpha", "bravo")}
    OrderingPerson(world, "stop", present(world))
    world.run(2.0)
    stop = captured(world, "bravo")
    world.desks["desk"].given_up = True
    OrderingPerson(world, "lift", {"bravo": world.posts["bravo"].orders.epochs}, name="other")
    world.run(2.0)
    bravo = world.posts["bravo"]
    bravo.came(stop, "attacker")
    world.run(2.0)
    assert bravo.executed == [("lift", "fog")]
    assert not bravo.held["stop"]


def test_a_lift_does_not_end_a_stop_given_after_it():
    world = taught(World("alpha"))
    alpha = world.posts["alpha"]
    OrderingPerson(world, "stop", present(world))
    world.run(1.0)
    world.delay = 0.3
    lift = OrderingPerson(world, "lift", present(world), name="lifts")
    world.delay = 0.01
    OrderingPerson(world, "stop", present(world), name="stops", reason="again")
    world.run(5.0)
    assert alpha.executed == [("stop", "fog"), ("stop", "again")]
    assert alpha.held["stop"]
    found = lift.asking.results["alpha"]
    assert isinstance(found, OrderConfirmed)
    assert found.trouble == "newer"


@pytest.mark.parametrize("seed", range(8))
def test_a_stop_given_together_with_a_lift_prevails(seed):
    world = taught(World("alpha", loss=0.3, seed=seed))
    alpha = world.posts["alpha"]
    first = OrderingPerson(world, "stop", present(world), name="first")
    world.run(10.0, lambda: first.is_done)
    stop = OrderingPerson(world, "stop", present(world), name="stops", reason="again")
    OrderingPerson(world, "lift", {"alpha": first.asking.epochs["alpha"]}, name="lifts")
    world.run(20.0, lambda: stop.is_done)
    world.run(20.0)
    assert alpha.held["stop"]
    assert alpha.executed.count(("stop", "again")) == 1


def test_a_host_restarted_before_its_confirmation_executes_only_the_present_stop():
    world = taught(World("alpha"))
    alpha = world.posts["alpha"]
    alpha.slow = 0.5
    desk = OrderingPerson(world, "stop", present(world))
    world.run(0.1)
    assert alpha.executed == [("stop", "fog")]
    stop = captured(world, "alpha")
    alpha.boot()
    world.run(5.0)
    assert alpha.executed == [("stop", "fog"), ("stop", "fog")]
    assert isinstance(desk.asking.results["alpha"], OrderConfirmed)
    desk.given_up = True
    OrderingPerson(world, "lift", present(world), name="lifts")
    world.run(1.0)
    alpha.boot()
    alpha.came(stop, "attacker")
    world.run(1.0)
    assert alpha.executed[-1] == ("lift", "fog")


def test_a_host_whose_journal_has_the_stop_only_confirms_it():
    world = taught(World("alpha"))
    alpha = world.posts["alpha"]
    alpha.slow = 0.5
    desk = OrderingPerson(world, "stop", present(world))
    world.run(0.1)
    alpha.boot({desk.asking.id: ("stop", True)})
    world.run(5.0)
    assert alpha.executed == [("stop", "fog")]
    assert isinstance(desk.asking.results["alpha"], OrderConfirmed)


# --- rights ------------------------------------------------------------------------------------------


def test_a_person_without_the_right_to_stop_is_denied():
    world = World("alpha")
    desk = OrderingPerson(world, "stop", present(world), person("oli", frozenset({Right.OBSERVE})))
    world.run(3.0)
    denied = desk.asking.results["alpha"]
    assert isinstance(denied, OrderDenied)
    assert "takes the right to stop" in denied.reason
    assert world.posts["alpha"].executed == []


def test_a_person_with_only_the_right_to_stop_may_not_lift():
    world = World("alpha")
    identity = person("sam", frozenset({Right.OBSERVE, Right.STOP}))
    OrderingPerson(world, "stop", present(world), identity)
    world.run(3.0)
    desk = OrderingPerson(world, "lift", present(world), identity, name="lifts")
    world.run(3.0)
    assert isinstance(desk.asking.results["alpha"], OrderDenied)
    assert world.posts["alpha"].held["stop"]


def test_a_host_may_stop_another_and_not_lift():
    world = World("alpha", "bravo")
    OrderingPerson(world, "stop", present(world, "alpha"), keys("host", "bravo"))
    world.run(3.0)
    desk = OrderingPerson(world, "lift", present(world, "alpha"), keys("host", "bravo"), name="lifts")
    world.run(3.0)
    assert world.posts["alpha"].executed == [("stop", "fog")]
    assert isinstance(desk.asking.results["alpha"], OrderDenied)


@pytest.mark.parametrize("known", [True, False])
def test_a_revoked_person_is_denied(known):
    world = taught(World("alpha")) if known else World("alpha")
    alpha = world.posts["alpha"]
    serial = OrderSigner(person()).identity.serial
    alpha.admission.on_revocation_list(
        authority(0).revocation_list(RevocationList(1, frozenset({serial}), AT))
    )
    desk = OrderingPerson(world, "stop", present(world))
    world.run(3.0)
    denied = desk.asking.results["alpha"]
    assert isinstance(denied, OrderDenied)
    assert "are revoked (list 1)" in denied.reason
    assert alpha.executed == []


def test_a_datagram_of_another_team_is_neither_executed_nor_answered():
    world = World("alpha")
    desk = OrderingPerson(world, "stop", present(world), person("anna", number=1))
    world.run(3.0)
    assert world.posts["alpha"].executed == []
    assert desk.asking.results == {}
    answers = [data for source, _, data in world.sent if source == "alpha"]
    assert {type(decode_datagram(data)).__name__ for data in answers} <= {"CertificateRequest"}


def test_a_datagram_for_another_host_is_dropped_before_any_check():
    world = taught(World("alpha", "bravo"))
    OrderingPerson(world, "stop", present(world, "alpha"))
    world.run(1.0)
    world.posts["bravo"].came(captured(world, "alpha"), "attacker")
    world.run(1.0)
    assert world.posts["bravo"].checks == 0
    assert world.posts["bravo"].executed == []


# --- bad input and floods ----------------------------------------------------------------------------


def sent_order() -> tuple[World, bytes]:
    world = taught(World("alpha"))
    OrderingPerson(world, "stop", present(world))
    world.sent, sent = [], world.sent
    world._events.clear()
    return world, sent[0][2]


def test_truncated_and_changed_datagrams_are_not_executed():
    world, data = sent_order()
    alpha = world.posts["alpha"]
    bent = [data[:end] for end in range(len(data))]
    bent += [data[:at] + bytes([data[at] ^ 1 << at % 8]) + data[at + 1 :] for at in range(len(data))]
    signed = decode_datagram(data)
    assert isinstance(signed, SignedOrder)
    for number, one in enumerate(bent):
        alpha.came(one, f"attacker {number}", f"network {number}")
        world.run(0.05)
        if alpha.executed:
            # Unsigned fields, such as the number of the attempt, may differ.
            found = decode_datagram(one)
            assert isinstance(found, SignedOrder)
            assert (found.order, found.signature) == (signed.order, signed.signature)
            alpha.executed.clear()
            alpha.boot()
            taught(world)
            world._events.clear()
            alpha.orders.epochs = Epochs(b"n" * 8, b"n" * 8)
    assert alpha.executed == []


def test_the_answer_to_an_unverified_datagram_is_not_larger():
    world = World("alpha")
    desk = OrderingPerson(world, "stop", present(world))
    data = captured(world, "alpha")
    world.posts["alpha"].came(data, "attacker")
    (answer,) = [data for source, target, data in world.sent if target == "attacker"]
    assert len(answer) <= len(data)
    assert desk.asking.results == {}


def test_a_flood_of_forged_datagrams_from_one_address_does_not_delay_a_stop():
    world, data = sent_order()
    alpha = world.posts["alpha"]
    signed = decode_datagram(data)
    assert isinstance(signed, SignedOrder)
    decoded = 0
    for number in range(20_000):
        if alpha.datagrams.may_decode(Sender("there", "flooder")):
            decoded += 1
            forged = replace(signed, signature=number.to_bytes(64))
            alpha.came(encode_datagram(forged), "flooder", "there")
        if number % 100 == 0:
            world.run(0.01)
    assert decoded <= 64 + 32 * 2 + 1
    assert alpha.checks <= 6 + 3 * 2 + 1
    desk = OrderingPerson(world, "stop", present(world), name="real")
    world.run(5.0, lambda: desk.is_done)
    assert desk.done_at is not None
    assert desk.done_at - 2.0 < 0.2
    assert alpha.executed == [("stop", "fog")]


def test_few_datagrams_of_a_flood_from_many_ports_are_decoded():
    world = taught(World("alpha"))
    datagrams = world.posts["alpha"].datagrams
    decoded = sum(datagrams.may_decode(Sender("there", number % 3_000)) for number in range(20_000))
    assert decoded <= 256
    assert datagrams.may_decode(Sender("elsewhere", "desk"))


def test_a_flood_from_many_ports_does_not_affect_a_verified_sender():
    world = taught(World("alpha"))
    alpha = world.posts["alpha"]
    OrderingPerson(world, "pause", present(world))
    world.run(1.0)
    signed = decode_datagram(captured(world, "alpha"))
    assert isinstance(signed, SignedOrder)
    before = alpha.checks
    for number in range(5_000):
        alpha.came(encode_datagram(replace(signed, signature=number.to_bytes(64))), f"{number}", "there")
    assert alpha.checks - before <= 25
    desk = OrderingPerson(world, "stop", present(world))
    world.run(5.0, lambda: desk.is_done)
    assert desk.is_done
    assert alpha.executed[-1] == ("stop", "fog")


def test_orders_do_not_depend_on_the_wall_clock(monkeypatch):
    monkeypatch.setattr("time.time", lambda: 0.0)
    world = taught(World("alpha"))
    desk = OrderingPerson(world, "stop", present(world))
    world.run(1.0)
    assert desk.is_done


def test_an_answer_is_accepted_only_from_its_host():
    world = taught(World("alpha", "bravo"))
    desk = OrderingPerson(world, "stop", present(world, "alpha"))
    answer = OrderConfirmed(desk.asking.id, Epochs(), ("p.fc",), {})
    for liar in (keys("host", "bravo"), person(), keys("host", "alpha", number=1)):
        desk.asking.on_datagram(encode_datagram(OrderSigner(liar).answer(answer, unknown=True)), 0.0)
    assert desk.asking.results == {}


def test_a_signature_of_an_answer_is_invalid_for_an_order():
    signer = OrderSigner(keys("host", "alpha"))
    answer = signer.answer(OrderDenied(bytes(16), ""), unknown=True)
    forged = SignedOrder(answer.answer, answer.signer, answer.signature, answer.certificate)
    with pytest.raises(Exception, match="its content differs from that signed by host alpha"):
        verify_order(forged, None, keys("host", "alpha").authority)
