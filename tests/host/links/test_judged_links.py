"""Certificates that expire, start or are revoked while hosts run: closed links, and links that may finish."""

from __future__ import annotations

import asyncio
import time

import memory_network
import msgspec
import pytest
from msgspec.structs import replace

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.certificate_reader import revoked_in
from lfield.authority.identity import ALL_RIGHTS, NO_RIGHTS, Identity
from lfield.authority.peer_verification import NONE_REVOKED
from lfield.authority.trusted_clock import TrustedClock
from lfield.errors import HandshakeError
from lfield.operator.client import SNAPSHOT, emergency_stop
from lfield.operator.observer_link import send_request
from lfield.simulate.jumping_loop import LoopClock
from lfield.testing.keyring import Keyring
from lfield.wire.messages import HandshakeRefused, Hello, RevocationUpdate
from lfield.wire.observer_messages import EmergencyStop
from lfield.wire.subscription_messages import Subscribe

OBSERVER = Hello("observer", "observer", 0)

#: A coordinator that ends at once without an argument.
PROGRAM = """
resource Echo {
    init(string[] arg) { }
    portal say() { sleep(1.0); }
}
coordinator Caller {
    init(string[] arg) { if (arg.length() > 1) while (true) findEcho("echo").say(); }
}
"""
ENDLESS, DONE = (f"//Caller:tom@alpha{words}\n//Echo:echo@bravo\n" for words in ("?on", ""))
DAY = 86400.0


class OffsetClock(LoopClock):
    """The virtual clock with another wall time."""

    def __init__(self, begin: float) -> None:
        self._begin = begin

    def time(self) -> float:
        return self._begin + self.monotonic()


class CertificateWorld:
    """The identities on the network of a test, as in certificates. Seconds count from its beginning."""

    def __init__(self, folder, monkeypatch) -> None:
        self.ring = Keyring(folder)
        self.keys = self.ring.issue("host", "alpha")
        self.now = time.time()
        self.identities: dict[str, Identity] = {}
        self.kept: list[bytes] = []
        for number, name in enumerate(("alpha", "bravo", "desk")):
            kind, may = ("person", ALL_RIGHTS) if name == "desk" else ("host", NO_RIGHTS)
            at = self.now + 1000.0
            self.identities[name] = Identity(kind, name, may, f"a{number}", at - DAY, at + DAY, "ours")
        monkeypatch.setattr(
            memory_network, "host_at_address", lambda address: self.identities[address.partition(":")[0]]
        )

    def set(self, name: str, **fields) -> None:
        self.identities[name] = replace(self.identities[name], **fields)

    def ends(self, name: str, after: float) -> None:
        self.set(name, valid_until=self.now + 1000.0 + after)

    def list(self, number: int, *serials: str) -> bytes:
        return self.ring.revocation_list(number, *serials, at=self.now)

    def admission(self, name: str, data: bytes = b"", begin: float | None = None) -> CertificateAdmission:
        revoked = revoked_in(data, self.keys.authority) if data else NONE_REVOKED
        clock = OffsetClock(self.now if begin is None else begin)
        return CertificateAdmission(
            self.keys,
            self.identities[name],
            TrustedClock(clock),
            revoked,
            data,
            lambda data, _: self.kept.append(data),
        )


@pytest.fixture
def certificates(tmp_path, monkeypatch):
    return CertificateWorld(tmp_path / "keys", monkeypatch)


async def both_up(team, certificates, deployment, alpha=b"", bravo=b""):
    mission = team.mission(PROGRAM, deployment)
    lists = {"alpha": alpha, "bravo": bravo}
    options = {name: {"admission": certificates.admission(name, data)} for name, data in lists.items()}
    started = [team.make(mission, name, **more) for name, more in options.items()]
    await asyncio.gather(*(running.host.start() for running in started))
    return started


def linked(running):
    return bool(running.host.peers.incarnations)


async def test_in_flight_a_known_peer_with_an_expired_certificate_may_finish(team, /, certificates):
    certificates.ends("bravo", 20.0)
    alpha, bravo = await both_up(team, certificates, ENDLESS)
    await team.until(lambda: linked(alpha))
    await asyncio.sleep(60.0)
    assert linked(alpha)
    assert alpha.log.count("the certificate of host bravo expired") == 1
    team.network.cut("alpha", "bravo")
    await team.until(lambda: not linked(alpha))
    await team.until(lambda: linked(alpha))
    await send_request(team.network.transport("desk"), "alpha:8181", emergency_stop("enough"))
    await team.until(lambda: not linked(alpha))
    await team.until(lambda: "renew it with 'lfield keys renew host bravo'" in bravo.log)


async def test_an_unknown_peer_with_an_expired_certificate_gets_no_link(team, /, certificates):
    certificates.ends("bravo", -1.0)
    alpha, bravo = await both_up(team, certificates, ENDLESS)
    await team.until(lambda: "the certificate of host bravo expired" in alpha.log + bravo.log)
    await asyncio.sleep(20.0)
    assert not linked(alpha)


async def test_after_the_mission_a_peer_with_an_expired_certificate_loses_its_link(team, /, certificates):
    certificates.ends("bravo", 20.0)
    alpha, _ = await both_up(team, certificates, DONE)
    await team.until(lambda: linked(alpha))
    await asyncio.sleep(15.0)
    assert linked(alpha)
    await asyncio.sleep(15.0)
    assert not linked(alpha)


async def test_a_revocation_list_is_exchanged_and_stored(team, /, certificates):
    new = certificates.list(4, "ff")
    alpha, bravo = await both_up(team, certificates, DONE, alpha=new, bravo=certificates.list(3))
    await team.until(lambda: "revocation list 4 received" in bravo.log)
    assert certificates.kept == [new]
    assert bravo.host.hello().revoked == 0, "links exchange the list themselves"
    assert linked(alpha)
    assert linked(bravo)
    await asyncio.sleep(20.0)
    assert "revocation list" not in alpha.log


@pytest.mark.parametrize(("first", "second"), [(7, 8), (7, 7), (8, 7)])
async def test_revocations_are_merged_and_differing_lists_are_reported(team, /, certificates, first, second):
    """As after the restoration of an authority from an old copy."""
    alpha, bravo = await both_up(team, certificates, ENDLESS)
    await team.until(lambda: linked(alpha))
    desk = await _observer(team, "desk")
    for number, serial in ((first, "aa11"), (second, "bb22"), (second, "bb22")):
        desk.link.send(RevocationUpdate(certificates.list(number, serial)))
    missing, has, newest = ("aa11", first, second) if second > first else ("bb22", second, first)
    other = f"list {has}" if first != second else "another one of that number"
    line = f"list {newest} incomplete: it does not revoke {missing}, but {other} does"
    for host in (alpha, bravo):
        await team.until(lambda host=host: line in host.log)
        await asyncio.sleep(5.0)
        assert host.log.count(line) == 1
        assert f"'lfield keys revoke serial {missing}'" in host.log
        admission = host.host.options.admission
        assert (admission.number, admission.revoked.serials) == (newest, {"aa11", "bb22"})
        assert admission.list == certificates.list(newest, "aa11" if newest == first else "bb22")
    both = certificates.list(9, "aa11", "bb22")
    desk.link.send(RevocationUpdate(both))
    await team.until(lambda: "revocation list 9 received\n" in bravo.log)
    assert certificates.kept[-2:] == [both, both]


async def test_a_revoked_peer_loses_its_link_except_in_flight(team, /, certificates):
    for deployment, stays in ((DONE, False), (ENDLESS, True)):
        alpha, bravo = await both_up(team, certificates, deployment)
        await team.until(lambda alpha=alpha: linked(alpha))
        desk = await _send_list(team, certificates.list(7, certificates.identities["bravo"].serial))
        await asyncio.sleep(5.0)
        assert linked(alpha) == stays
        assert "the keys of host bravo are revoked (list 7)" in alpha.log
        desk.close()
        await bravo.host.stop()
        await alpha.host.stop()


async def test_a_revoked_host_gets_no_new_link_even_in_flight(team, /, certificates):
    alpha, _ = await both_up(team, certificates, ENDLESS)
    await team.until(lambda: linked(alpha))
    await _send_list(team, certificates.list(7, certificates.identities["bravo"].serial))
    await team.until(lambda: "are revoked" in alpha.log)
    team.network.cut("alpha", "bravo")
    await asyncio.sleep(20.0)
    assert not linked(alpha)


async def test_a_revoked_host_loses_its_observer_link_even_in_flight(team, /, certificates):
    alpha, _ = await both_up(team, certificates, ENDLESS)
    await team.until(lambda: linked(alpha))
    observer = await _observer(team, "bravo", Subscribe())
    desk = await _observer(team, "desk")
    desk.link.send(RevocationUpdate(certificates.list(7, certificates.identities["bravo"].serial)))
    await team.until(lambda: observer.over)
    assert "the keys of host bravo are revoked (list 7)" in observer.refused
    assert linked(alpha), "the link of the host itself stays, to finish"
    assert not desk.over


async def test_a_list_received_during_a_handshake_refuses_the_link(team, /, certificates):
    (alpha,) = await team.up(
        team.mission(PROGRAM, ENDLESS), "alpha", admission=certificates.admission("alpha")
    )
    slow = await _observer(team, "bravo", greets=alpha.host.hello())
    await team.until(lambda: slow.heard)
    await _send_list(team, certificates.list(7, certificates.identities["bravo"].serial))
    await team.until(lambda: slow.over)
    assert "are revoked (list 7)" in slow.refused
    assert not linked(alpha)


@pytest.mark.parametrize("name", ["bravo", "desk"])
async def test_with_an_expired_certificate_a_peer_may_still_observe_and_stop_in_flight(
    team, /, certificates, name
):
    certificates.ends(name, 5.0)
    alpha, _ = await both_up(team, certificates, ENDLESS)
    await team.until(lambda: linked(alpha))
    observer, lifts = [await _observer(team, name) for _ in range(2)]
    await asyncio.sleep(30.0)
    assert not observer.over
    lifts.link.send(EmergencyStop(bytes(16), "", lift=True))
    await team.until(lambda: lifts.over)
    assert ("may only observe and stop" if name == "desk" else "a person has it") in lifts.refused
    epoch = alpha.host.core.orders.epochs.hold
    observer.link.send(EmergencyStop(bytes(16), "enough", epoch=epoch))
    await team.until(lambda: observer.over)
    assert f"the certificate of {certificates.identities[name]} expired" in observer.refused
    assert "EMERGENCY STOP" in alpha.log


async def test_a_list_with_a_wrong_signature_closes_only_its_link(team, /, certificates):
    alpha, _ = await both_up(team, certificates, DONE)
    await team.until(lambda: linked(alpha))
    for data in (b"no list", Keyring(certificates.ring.folder).revocation_list(9, "a1", at=certificates.now)):
        await _send_list(team, data)
        await team.until(lambda: "link from desk closed: the revocation list" in alpha.log)
    assert linked(alpha)
    assert alpha.host.options.admission.number == 0


async def test_a_revoked_person_is_refused(team, /, certificates):
    await both_up(
        team, certificates, ENDLESS, alpha=certificates.list(1, certificates.identities["desk"].serial)
    )
    with pytest.raises(HandshakeError, match="the keys of desk are revoked"):
        await send_request(team.network.transport("desk"), "alpha:8181", SNAPSHOT)


async def test_a_person_with_an_expired_certificate_may_stop_a_flight(team, /, certificates):
    certificates.ends("desk", 5.0)
    alpha, _ = await both_up(team, certificates, ENDLESS)
    desk = team.network.transport("desk")
    await send_request(desk, "alpha:8181", SNAPSHOT)
    await asyncio.sleep(30.0)
    await send_request(desk, "alpha:8181", SNAPSHOT)
    with pytest.raises(HandshakeError, match=r"expired .*; until then desk may only observe and stop"):
        await send_request(desk, "alpha:8181", emergency_stop("", lift=True))
    await send_request(desk, "alpha:8181", emergency_stop("enough"))
    with pytest.raises(HandshakeError, match="the certificate of desk expired"):
        await send_request(desk, "alpha:8181", SNAPSHOT)
    assert "EMERGENCY STOP by desk: enough" in alpha.log


async def test_a_clock_that_is_years_behind_uses_the_time_of_the_authority_and_the_team(
    team, /, certificates
):
    mission = team.mission(PROGRAM, DONE)
    old = certificates.admission("alpha", begin=0.0)
    (alpha,) = await team.up(mission, "alpha", admission=old)
    assert "system clock behind: it shows 1970-01-01" in alpha.log
    assert "since the certificate of host alpha began then" in alpha.log
    (bravo,) = await team.up(mission, "bravo", admission=certificates.admission("bravo"))
    await team.until(lambda: linked(alpha) and linked(bravo))
    assert "since host bravo has sent that time" in alpha.log
    assert abs(old.time.now() - certificates.now - LoopClock().monotonic()) < 5.0


class ObserverClient:
    """Keeps its link, and records how it ends."""

    def __init__(self) -> None:
        self.refused, self.heard, self.over = "", False, False

    def on_message(self, link, message):
        self.heard = True
        link.accept_role("host")
        if isinstance(message, HandshakeRefused):
            self.refused = message.reason

    def on_closed(self, link, error):
        self.over = True


async def _observer(team, name, *arguments, greets=None):
    """A client with a link to alpha, as an observer; or as a host with the Hello `greets`."""
    client = ObserverClient()
    client.link = await team.network.transport(name).connect("alpha:8181", client)
    for message in (
        msgspec.structs.replace(greets, host=name, incarnation=9) if greets else OBSERVER,
        *arguments,
    ):
        client.link.send(message)
    return client


async def _send_list(team, data):
    """A person sends a revocation list."""
    return (await _observer(team, "desk", RevocationUpdate(data))).link
