"""Orders of an operator by datagrams and connections in parallel: the first confirmation counts."""

from __future__ import annotations

import asyncio
import socket

import pytest
from simulated_hosts import EXECUTES, Network, keys

from lfield.authority import keystore
from lfield.authority.identity import Right
from lfield.authority.order_signing.order_signatures import OrderSigner
from lfield.errors import AddressError, HandshakeError, NoListener
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.operator.client import ask_all, ask_teams, emergency_stop, pause
from lfield.operator.orders import path_race
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.targets import HostRef, TargetTeam
from lfield.simulate.jumping_loop import run_jumping
from lfield.wire.observer_messages import EmergencyStopResult


def given(network, request=None, desk=None, open_links=None):
    """The answer of each host to an order, and the time of each answer (s)."""
    elapsed = {}

    async def scenario():
        started = network.now
        return await ask_all(
            network,
            network.addresses,
            request or emergency_stop("fire"),
            sender=desk or network.sender(),
            open_link=open_links,
            on_answer=lambda host, answer: elapsed.setdefault(host, network.now - started),
        )

    return run_jumping(scenario()), elapsed


def taught(network):
    """An operator that has had connections with the hosts before."""
    desk = network.sender()
    for name, host in network.hosts.items():
        host.certificates.add_der(OrderSigner(keys("person", "anna", frozenset(Right))).certificate)
        desk.known.learn(
            name, epochs=host.orders.epochs, certificate=OrderSigner(keys("host", name)).certificate
        )
    return desk


def all_confirmed(network, answers):
    return all(answers[name].devices == host.devices for name, host in network.hosts.items())


def test_a_stop_to_known_hosts_takes_one_round_trip():
    network = Network(5)
    answers, elapsed = given(network, desk=taught(network))
    assert all_confirmed(network, answers)
    assert max(elapsed.values()) == pytest.approx(network.trip + EXECUTES, abs=0.01)
    assert not network.dialled


def test_a_stop_to_unknown_hosts_takes_two_round_trips():
    network = Network(1)
    answers, elapsed = given(network)
    assert all_confirmed(network, answers)
    assert elapsed["h1"] == pytest.approx(2 * network.trip + EXECUTES, abs=0.01)
    assert [kind for kind, _ in network.hosts["h1"].executed] == ["stop"]


def test_the_order_after_a_first_one_takes_one_round_trip():
    network, desk = Network(3), None
    desk = network.sender()
    given(network, desk=desk)
    _, elapsed = given(network, pause(), desk=desk)
    assert max(elapsed.values()) == pytest.approx(network.trip + EXECUTES, abs=0.01)


def test_a_stop_to_a_restarted_host_takes_two_round_trips():
    network = Network(1)
    desk = taught(network)
    network.hosts["h1"].boot()
    answers, elapsed = given(network, desk=desk)
    assert all_confirmed(network, answers)
    assert elapsed["h1"] == pytest.approx(2 * network.trip + EXECUTES, abs=0.01)


def test_a_stop_after_a_lift_of_another_operator_is_challenged_and_signed_again():
    network = Network(1)
    desk = taught(network)
    network.hosts["h1"].orders.mark_executed("lift", bytes(16))
    answers, _ = given(network, desk=desk)
    assert all_confirmed(network, answers)
    assert [kind for kind, _ in network.hosts["h1"].executed] == ["stop"]


def test_a_lift_names_the_state_of_the_host_and_not_a_cached_one():
    network = Network(1)
    desk = taught(network)
    network.hosts["h1"].orders.mark_executed("stop", bytes(16))
    answers, _ = given(network, emergency_stop("", lift=True), desk)
    assert answers["h1"] == EmergencyStopResult(
        {"h1.fc": ""}, "", answers["h1"].id, network.hosts["h1"].orders.epochs
    )
    assert [kind for kind, _ in network.hosts["h1"].executed] == ["lift"]


@pytest.mark.parametrize("order", [emergency_stop, lambda reason: emergency_stop(reason, lift=True)])
@pytest.mark.parametrize("seed", range(10))
def test_lost_and_repeated_datagrams_execute_an_order_once(order, seed):
    network = Network(5, loss=0.3, seed=seed)
    network.twice = True
    answers, _ = given(network, order("fire"))
    assert all_confirmed(network, answers)
    assert all(len(host.executed) == 1 for host in network.hosts.values())


def test_at_20_percent_loss_99_percent_of_stops_take_under_half_a_second():
    slow, late = [], 0
    for seed in range(40):
        network = Network(5, trip=0.02, loss=0.2, seed=seed)
        _, elapsed = given(network, desk=taught(network))
        slow += elapsed.values()
        late += len(network.dialled)
    assert sorted(slow)[int(0.99 * len(slow))] <= 0.5
    assert late <= 40


def test_a_connection_confirms_where_datagrams_are_blocked():
    network = Network(2)
    network.udp = lambda host: False
    answers, elapsed = given(network)
    assert all_confirmed(network, answers)
    assert len(network.dialled) == 2
    assert max(elapsed.values()) <= 1.0


def test_no_connection_starts_while_datagrams_are_answered():
    network = Network(1)
    network.tcp = lambda host: False
    given(network)
    assert not network.dialled


def test_datagrams_confirm_where_connections_fail():
    for refused in (True, False):
        network = Network(1, trip=0.8)
        network.tcp, network.refused = (lambda host: False), (lambda host, refused=refused: refused)
        answers, _ = given(network)
        assert all_confirmed(network, answers)


def test_unreached_hosts_are_ordered_through_reached_hosts():
    network = Network(4)
    network.udp = network.tcp = lambda host: host != "h3"
    answers, elapsed = given(network)
    assert all_confirmed(network, answers)
    assert elapsed["h3"] <= 2.0


def test_a_refused_connection_reports_a_missing_host():
    network = Network(2)
    network.udp, network.refused = (lambda host: host != "h2"), (lambda host: host == "h2")
    network.hosts["h1"].linked = list
    answers, elapsed = given(network)
    assert isinstance(answers["h2"], NoListener)
    assert elapsed["h2"] <= 2.0
    assert answers["h1"].devices == {"h1.fc": ""}


def test_an_order_without_any_answer_ends_within_its_timeout():
    network = Network(1)
    network.udp = network.tcp = lambda host: False
    answers, elapsed = given(network)
    assert isinstance(answers["h1"], AddressError)
    assert elapsed["h1"] <= emergency_stop("").timeout + path_race.DATAGRAM_TIME + path_race.GRACE + 2.0


def test_an_operator_without_the_right_is_refused_at_once():
    network = Network(1)
    answers, elapsed = given(network, desk=network.sender(may=frozenset({Right.OBSERVE})))
    assert isinstance(answers["h1"], HandshakeError)
    assert "right to stop" in str(answers["h1"])
    assert elapsed["h1"] <= 0.3
    assert not network.hosts["h1"].executed


def test_a_device_list_too_long_for_a_datagram_comes_by_connection():
    network = Network(1)
    network.hosts["h1"].devices = {f"h1.{'x' * 60}{n}": "" for n in range(40)}
    answers, _ = given(network)
    assert all_confirmed(network, answers)
    network.tcp = lambda host: False
    answers, _ = given(network)
    assert isinstance(answers["h1"], AddressError)
    assert "does not say how" in str(answers["h1"])


def test_fifty_hosts_are_stopped_at_loss():
    network = Network(50, loss=0.2, seed=3)
    answers, _ = given(network)
    assert all_confirmed(network, answers)
    assert all(len(host.executed) == 1 for host in network.hosts.values())


# --- open connections ----------------------------------------------------------------------------


def standing_of(network, after):
    """An open connection that answers or fails after some seconds."""

    async def order(host, message):
        await asyncio.sleep(abs(after))
        if after < 0:
            raise AddressError(host, "it is lost")
        return EmergencyStopResult({f"{host}.fc": ""}, "", message.id)

    return order


def test_an_open_connection_answers_first_and_no_other_is_made():
    network = Network(3)
    network.udp = lambda host: False
    answers, elapsed = given(network, open_links=standing_of(network, 0.4))
    assert all_confirmed(network, answers)
    assert list(elapsed.values()) == [pytest.approx(0.4)] * 3
    assert not network.dialled


def test_a_new_connection_replaces_a_lost_or_silent_one():
    for after in (-0.3, 60.0):
        network = Network(1)
        network.udp = lambda host: False
        answers, elapsed = given(network, open_links=standing_of(network, after))
        assert all_confirmed(network, answers)
        assert elapsed["h1"] <= 2.0
        assert len(network.dialled) == 1


# --- cache of known hosts ------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "lfield" / "hosts"


def test_known_hosts_are_cached_and_a_damaged_cache_costs_a_round_trip(cache):
    network, own = Network(2), keys("person", "anna", frozenset(Right))
    given(network, desk=network.sender(KnownHosts.read(own.authority)))
    assert KnownHosts.read(own.authority).host("h1").epochs == network.hosts["h1"].orders.epochs
    _, elapsed = given(network, desk=network.sender(KnownHosts.read(own.authority)))
    assert max(elapsed.values()) == pytest.approx(network.trip + EXECUTES, abs=0.01)
    for damaged in (b"", b"\x00", cache.read_bytes()[:-1], cache.read_bytes() + b"\x00", b"\xff" * 2000):
        cache.write_bytes(damaged)
        answers, _ = given(network, desk=network.sender(KnownHosts.read(own.authority)))
        assert all_confirmed(network, answers)


def test_a_cache_file_that_others_may_write_is_neither_read_nor_followed(cache, tmp_path):
    own = keys("person", "anna", frozenset(Right))
    known = KnownHosts(own.authority)
    known.learn("h1", trip=0.2)
    known.save()
    assert KnownHosts.read(own.authority).host("h1").trip == 0.2
    assert KnownHosts.read(b"another authority").host("h1").trip is None
    cache.chmod(0o666)
    assert KnownHosts.read(own.authority).host("h1").trip is None
    cache.rename(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").chmod(0o600)
    cache.symlink_to(tmp_path / "elsewhere")
    assert KnownHosts.read(own.authority).host("h1").trip is None
    cache.unlink()
    cache.parent.chmod(0o777)
    known.learn("h1", trip=0.3)
    known.save()
    assert not cache.exists()


def test_a_host_with_a_new_certificate_is_asked_for_it():
    network = Network(2)
    desk = taught(network)
    keys.cache_clear()
    network.hosts["h1"].boot()
    answers, _ = given(network, desk=desk)
    assert all_confirmed(network, answers)
    assert not network.dialled


# --- with sockets --------------------------------------------------------------------------------


def test_a_command_stops_a_host_by_datagrams_on_loopback(cache, tmp_path):
    keystore.write_keys(tmp_path / "keys" / keystore.OWN, keys("person", "anna", frozenset(Right)))

    async def scenario():
        host = Network(1).hosts["h1"]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as port:
            port.bind(("127.0.0.1", 0))
            host.send = lambda sender, data: port.sendto(data, sender.address)
            received = []

            def read():
                data, sender = port.recvfrom(2000)
                received.append(data)
                host.datagrams.on_datagram(data, Sender("desk", sender))

            asyncio.get_running_loop().add_reader(port, read)
            target = TargetTeam((), {"h1": f"127.0.0.1:{port.getsockname()[1]}"})
            for request in (emergency_stop("fire"), pause()):
                answers = await asyncio.to_thread(ask_teams, [target], request, tmp_path / "keys")
                assert answers[HostRef("", "h1")].devices == host.devices
                received.append(None)
            asyncio.get_running_loop().remove_reader(port)
        return host, received

    host, received = asyncio.run(scenario())
    assert [kind for kind, _ in host.executed] == ["stop", "pause"]
    # The first order asks for the host's state and shows the certificate, unless a repetition arrives in
    # between.
    assert received.index(None) >= 2
    assert cache.exists()
