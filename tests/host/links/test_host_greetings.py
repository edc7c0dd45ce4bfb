"""Hosts that refuse a link: both report the reason in one sentence."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import memory_network
import msgspec

from lfield.authority.identity import ALL_RIGHTS, NO_RIGHTS, Identity
from lfield.errors import AddressError
from lfield.mission.access.signed_bundle import BundleId
from lfield.net.link_manager import MAX_OBSERVERS
from lfield.net.link_owner import RateLimitedLog
from lfield.net.session import Session
from lfield.wire.messages import HandshakeRefused, Hello
from lfield.wire.subscription_messages import EventBatch, Subscribe

PROGRAM = """
resource Echo {
    init(string[] arg) { }
    portal say() { write("here\\n"); }
}
coordinator Caller {
    init(string[] arg) { findEcho(arg[1]).say(); }
}
"""
DEPLOYMENT = "//Caller:tom@alpha?echo\n//Echo:echo@bravo\n"


def _log_lines(running, words):
    return [line for line in running.log.splitlines() if words in line]


async def _stays_refused(team, alpha, bravo, words):
    await team.until(lambda: _log_lines(alpha, words) and _log_lines(bravo, words))
    assert len(_log_lines(alpha, words)) == 1
    await asyncio.sleep(5.0)
    assert len(_log_lines(alpha, words)) == 1, "reported once for all attempts"
    assert bravo.output == []


async def test_hosts_of_two_programs_do_not_link(team, /):
    (bravo,) = await team.up(team.mission(PROGRAM.replace("here", "there"), DEPLOYMENT), "bravo")
    (alpha,) = await team.up(team.mission(PROGRAM, DEPLOYMENT, without=("bravo",)), "alpha")
    await _stays_refused(team, alpha, bravo, "start both from the same program file")
    assert "link to bravo refused" in alpha.log


async def test_hosts_of_two_deployments_do_not_link(team, /):
    (bravo,) = await team.up(team.mission(PROGRAM, DEPLOYMENT + "//Echo:more@alpha\n"), "bravo")
    (alpha,) = await team.up(team.mission(PROGRAM, DEPLOYMENT, without=("bravo",)), "alpha")
    await _stays_refused(team, alpha, bravo, "start both from the same .dL file")


async def test_hosts_whose_bundles_differ_only_in_bindings_do_not_link(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT, without=("bravo",))
    one, other = (replace(mission, release=BundleId(digest * 32, by="anna")) for digest in (b"1", b"2"))
    (bravo,) = await team.up(other, "bravo")
    (alpha,) = await team.up(one, "alpha")
    await _stays_refused(team, alpha, bravo, "copy one of the two to both")


async def test_a_host_of_files_and_one_of_a_bundle_link(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    files = replace(mission, release=BundleId(b"1" * 32, by="anna", is_from_files=True))
    (bravo,) = await team.up(files, "bravo")
    await team.up(replace(mission, release=BundleId(b"2" * 32, by="anna")), "alpha")
    assert await team.ended("tom") == "done"
    assert bravo.output == ["here"]


async def test_a_wrong_address_is_reported_by_both_hosts(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT + "//Echo:third@carol\n", without=("bravo", "carol"))
    (carol,) = await team.up(mission, "carol", address="bravo:8181")
    (alpha,) = await team.up(mission, "alpha", unreachable_after=3.0)
    await team.until(lambda: _log_lines(alpha, "carol answered at the address of bravo"))
    assert _log_lines(carol, "correct the address or the --map")
    assert await team.ended("tom") == "died"


async def test_a_second_host_with_the_same_name_is_refused_and_the_first_continues(team, /):
    mission = team.mission(PROGRAM.replace("findEcho", "sleep(30.0); findEcho"), DEPLOYMENT)
    alpha, bravo = await team.up(mission)
    (second,) = await team.up(mission, "alpha", address="elsewhere:8181")
    text = "bravo already has a link to another alpha"
    await team.until(lambda: _log_lines(second, text) and _log_lines(bravo, text))
    assert await team.ended("tom") == "done"
    assert bravo.output.count("here") == 1
    assert not _log_lines(alpha, text)


class UnknownPeers:
    """Has a link of a client that never sends a Hello."""

    def __init__(self, note):
        self.log_once = RateLimitedLog(note, self.now).write

    def now(self):
        return 0.0

    def on_link_closed(self, session):
        pass


def test_repeated_resets_of_one_client_are_reported_once():
    log = []
    peers = UnknownPeers(log.append)
    for port in (40001, 40002, 40003):
        session = Session(peers, None)
        session.link = type("Reset", (), {"peer": f"192.0.2.7:{port}"})()
        session.on_closed(session.link, AddressError(session.link.peer, "the connection was lost: reset"))
    assert log == ["link from 192.0.2.7 closed: the connection was lost: reset"]


class EagerTransport:
    """Delivers the first data of a new link before `connect` returns, as TCP may."""

    def __init__(self, network, machine):
        self.network, self.machine = network, machine

    async def listen(self, address, on_link):
        return self.network.listen(self.machine, address, on_link)

    async def connect(self, address, handler, host=""):
        link = self.network.connect(self.machine, address, handler)
        self.network.run()
        return link


async def test_a_hello_may_be_read_before_connect_returns(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    (bravo,) = await team.up(mission, "bravo")
    alpha = team.make(mission, "alpha")
    alpha.host.peers._transport = EagerTransport(team.network, "alpha")
    await alpha.host.start()
    assert await team.ended("tom") == "done"
    assert bravo.output == ["here"]
    assert "link from " not in alpha.log + bravo.log
    assert team.network.sent["Hello"] == 2


class SlowTransport(EagerTransport):
    """Connects after a while, as if the first packets were lost."""

    async def connect(self, address, handler, host=""):
        await asyncio.sleep(6.0)
        return self.network.connect(self.machine, address, handler)


ROUND = """
resource Echo {
    init(string[] arg) { }
    portal say() { write("here\\n"); sleep(3.0); }
}
coordinator Caller {
    init(string[] arg) { for (int i = 1; i < arg.length(); i = i + 1) findEcho(arg[i]).say(); }
}
"""


async def test_a_hello_has_the_state_at_the_time_of_the_connection(team, /):
    """A coordinator that arrived during the attempt may be unknown to all other hosts."""
    away = "//Echo:last@away\n//Echo:first@carol\n//Caller:tom@home?first&last&last&last\n"
    mission = team.mission(ROUND, away)
    away, carol, home = await team.up(mission)
    away.host.peers._transport = SlowTransport(team.network, "away")
    await team.until(lambda: carol.output)
    await home.host.stop()
    await team.until(lambda: away.output)
    await carol.host.stop()
    _, home = await team.up(mission, "carol", "home", first_start=False)
    await team.until(lambda: _log_lines(home, "link to away established"))
    assert _log_lines(home, "tom not started again: it is alive on another host")
    assert not home.holds("tom")


class Caller:
    """A client that sends a Hello, requests a snapshot, and keeps the answers."""

    def __init__(self, hello):
        self.hello, self.heard, self.ends = hello, [], []

    def on_message(self, link, message):
        link.accept_role("host")
        self.heard.append(message)
        if self.hello.role == "observer" and isinstance(message, Hello):
            link.send(Subscribe(once=True))

    def on_closed(self, link, error):
        self.ends.append(error)


async def last_answer(team, address, hello):
    caller = Caller(hello)
    link = await team.network.transport("bravo").connect(address, caller)
    link.send(hello)
    await team.until(lambda: caller.ends or any(isinstance(message, EventBatch) for message in caller.heard))
    link.close()
    return caller.heard[-1]


async def test_a_local_user_may_send_commands_and_is_refused_as_a_host(team, /, monkeypatch):
    """The identity comes from the kernel for a Unix socket; here it comes from the network."""
    mission = team.mission(PROGRAM, DEPLOYMENT)
    (alpha,) = await team.up(mission, "alpha", control_socket="alpha:1")
    monkeypatch.setattr(memory_network, "host_at_address", lambda _: Identity("local", "bob", ALL_RIGHTS))
    assert isinstance(await last_answer(team, "alpha:1", Hello("observer", "observer", 0)), EventBatch)
    known = alpha.host.hello()
    bravo = msgspec.structs.replace(known, host="bravo", incarnation=7)
    refused = await last_answer(team, "alpha:1", bravo)
    assert isinstance(refused, HandshakeRefused)
    assert "and user bob of this computer may only send commands" in refused.reason
    assert _log_lines(alpha, "may only send commands")
    assert "bravo" not in alpha.host.peers.incarnations
    monkeypatch.setattr(memory_network, "host_at_address", lambda _: Identity("local", "bob", NO_RIGHTS))
    refused = await last_answer(team, "alpha:1", Hello("observer", "observer", 0))
    assert "user bob of this computer has no permission here" in refused.reason


async def test_a_host_without_its_control_socket_reports_it_and_runs(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    await team.up(mission, "bravo")
    (alpha,) = await team.up(mission, "alpha", control_socket="bravo:8181")
    assert _log_lines(alpha, " without control socket: ")
    assert await team.ended("tom") == "done"


async def test_the_connection_limit_of_one_observer_does_not_affect_others(team, /, monkeypatch):
    """Also if both have the same address: behind one router, or on one computer."""
    mission = team.mission(PROGRAM, DEPLOYMENT)
    await team.up(mission, "alpha", control_socket="alpha:1")
    desk, hello = team.network.transport("desk"), Hello("observer", "observer", 0)

    async def observe(name):
        caller = Caller(hello)
        monkeypatch.setattr(memory_network, "host_at_address", lambda _: Identity("local", name, ALL_RIGHTS))
        (await desk.connect("alpha:1", caller)).send(hello)
        await team.until(lambda: any(isinstance(message, EventBatch) for message in caller.heard))
        return caller

    ben = await observe("ben")
    annas = [await observe("anna") for _ in range(5 * MAX_OBSERVERS)]
    await team.until(lambda: sum(not anna.ends for anna in annas) == MAX_OBSERVERS - 1)
    assert ben.ends == []


async def test_a_stopping_host_closes_silent_links(team, /):
    (alpha,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "alpha", control_socket="alpha:1")
    silent = Quiet()
    await team.network.transport("desk").connect("alpha:1", silent)
    await asyncio.sleep(1.0)
    assert not silent.ended
    await alpha.host.stop()
    # The time limit for a Hello has not expired.
    await asyncio.sleep(1.0)
    assert silent.ended


class Quiet:
    """A client that sends nothing."""

    ended = False

    def on_message(self, link, message):
        pass

    def on_closed(self, link, error):
        self.ended = True
