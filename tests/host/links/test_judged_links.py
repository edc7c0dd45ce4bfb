"""Certificates that end, begin or are revoked while hosts run: who loses a link, and who may finish."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import memory_network
import msgspec
import pytest

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

#: A coordinator that ends when it is told nothing.
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


class Wall(LoopClock):
    """Jumps as the loop does, from a day on that is ours."""

    def __init__(self, begin: float) -> None:
        self._begin = begin

    def time(self) -> float:
        return self._begin + self.monotonic()


class Judges:
    """Who is who on the network of a test, as certificates would say it. Seconds count from its beginning."""

    def __init__(self, folder, monkeypatch) -> None:
        self.ring = Keyring(folder)
        self.keys = self.ring.made("host", "alpha")
        self.now = time.time()
        self.who: dict[str, Identity] = {}
        self.kept: list[bytes] = []
        for number, name in enumerate(("alpha", "bravo", "desk")):
            kind, may = ("person", ALL_RIGHTS) if name == "desk" else ("host", NO_RIGHTS)
            at = self.now + 1000.0
            self.who[name] = Identity(kind, name, may, f"a{number}", at - DAY, at + DAY, "ours")
        monkeypatch.setattr(
            memory_network, "host_at_address", lambda address: self.who[address.partition(":")[0]]
        )

    def set(self, name: str, **fields) -> None:
        self.who[name] = replace(self.who[name], **fields)

    def ends(self, name: str, after: float) -> None:
        self.set(name, valid_until=self.now + 1000.0 + after)

    def list(self, number: int, *serials: str) -> bytes:
        return self.ring.revocation_list(number, *serials, at=self.now)

    def admission(self, name: str, data: bytes = b"", begin: float | None = None) -> CertificateAdmission:
        revoked = revoked_in(data, self.keys.authority) if data else NONE_REVOKED
        clock = Wall(self.now if begin is None else begin)
        return CertificateAdmission(
            self.keys,
            self.who[name],
            TrustedClock(clock),
            revoked,
            data,
            lambda data, _: self.kept.append(data),
        )


@pytest.fixture
def judges(tmp_path, monkeypatch):
    return Judges(tmp_path / "keys", monkeypatch)


async def both_up(team, judges, deployment, alpha=b"", bravo=b""):
    mission = team.mission(PROGRAM, deployment)
    lists = {"alpha": alpha, "bravo": bravo}
    options = {name: {"admission": judges.admission(name, data)} for name, data in lists.items()}
    started = [team.make(mission, name, **more) for name, more in options.items()]
    await asyncio.gather(*(running.host.start() for running in started))
    return started


def linked(running):
    return bool(running.host.peers.incarnations)


async def test_in_flight_a_known_peer_whose_certificate_ends_may_finish(team, /, judges):
    judges.ends("bravo", 20.0)
    alpha, bravo = await both_up(team, judges, ENDLESS)
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


async def test_a_peer_that_nobody_has_heard_before_and_whose_certificate_has_ended_gets_no_link(
    team, /, judges
):
    judges.ends("bravo", -1.0)
    alpha, bravo = await both_up(team, judges, ENDLESS)
    await team.until(lambda: "the certificate of host bravo expired" in alpha.log + bravo.log)
    await asyncio.sleep(20.0)
    assert not linked(alpha)


async def test_when_the_mission_is_over_a_certificate_that_ended_is_no_link_any_more(team, /, judges):
    judges.ends("bravo", 20.0)
    alpha, _ = await both_up(team, judges, DONE)
    await team.until(lambda: linked(alpha))
    await asyncio.sleep(15.0)
    assert linked(alpha)
    await asyncio.sleep(15.0)
    assert not linked(alpha)


async def test_a_revocation_list_travels_with_greetings_and_is_kept(team, /, judges):
    new = judges.list(4, "ff")
    alpha, bravo = await both_up(team, judges, DONE, alpha=new, bravo=judges.list(3))
    await team.until(lambda: "revocation list 4 received" in bravo.log)
    assert judges.kept == [new]
    assert bravo.host.hello().revoked == 0, "what links say of it is theirs"
    assert linked(alpha)
    assert linked(bravo)
    await asyncio.sleep(20.0)
    assert "revocation list" not in alpha.log


@pytest.mark.parametrize(("first", "second"), [(7, 8), (7, 7), (8, 7)])
async def test_what_any_list_has_revoked_stays_so_and_where_lists_differ_it_is_told(
    team, /, judges, first, second
):
    """As where a copy of the authority was put back, from before the first."""
    alpha, bravo = await both_up(team, judges, ENDLESS)
    await team.until(lambda: linked(alpha))
    desk = await _looks(team, "desk")
    for number, serial in ((first, "aa11"), (second, "bb22"), (second, "bb22")):
        desk.link.send(RevocationUpdate(judges.list(number, serial)))
    missing, has, newest = ("aa11", first, second) if second > first else ("bb22", second, first)
    other = f"list {has}" if first != second else "another one of that number"
    line = f"list {newest} incomplete: it does not revoke {missing}, and {other} does"
    for host in (alpha, bravo):
        await team.until(lambda host=host: line in host.log)
        await asyncio.sleep(5.0)
        assert host.log.count(line) == 1
        assert f"'lfield keys revoke serial {missing}'" in host.log
        admission = host.host.options.admission
        assert (admission.number, admission.revoked.serials) == (newest, {"aa11", "bb22"})
        assert admission.list == judges.list(newest, "aa11" if newest == first else "bb22")
    both = judges.list(9, "aa11", "bb22")
    desk.link.send(RevocationUpdate(both))
    await team.until(lambda: "revocation list 9 received\n" in bravo.log)
    assert judges.kept[-2:] == [both, both]


async def test_a_revoked_peer_loses_its_link_unless_something_flies(team, /, judges):
    for deployment, stays in ((DONE, False), (ENDLESS, True)):
        alpha, bravo = await both_up(team, judges, deployment)
        await team.until(lambda alpha=alpha: linked(alpha))
        desk = await _says(team, judges.list(7, judges.who["bravo"].serial))
        await asyncio.sleep(5.0)
        assert linked(alpha) == stays
        assert "the keys of host bravo are revoked (list 7)" in alpha.log
        desk.close()
        await bravo.host.stop()
        await alpha.host.stop()


async def test_a_revoked_host_is_not_linked_anew_even_in_flight(team, /, judges):
    alpha, _ = await both_up(team, judges, ENDLESS)
    await team.until(lambda: linked(alpha))
    await _says(team, judges.list(7, judges.who["bravo"].serial))
    await team.until(lambda: "are revoked" in alpha.log)
    team.network.cut("alpha", "bravo")
    await asyncio.sleep(20.0)
    assert not linked(alpha)


async def test_a_revoked_host_keeps_no_link_on_which_it_only_looks_even_in_flight(team, /, judges):
    alpha, _ = await both_up(team, judges, ENDLESS)
    await team.until(lambda: linked(alpha))
    looks = await _looks(team, "bravo", Subscribe())
    desk = await _looks(team, "desk")
    desk.link.send(RevocationUpdate(judges.list(7, judges.who["bravo"].serial)))
    await team.until(lambda: looks.over)
    assert "the keys of host bravo are revoked (list 7)" in looks.refused
    assert linked(alpha), "the link of the host itself stays, to finish"
    assert not desk.over


async def test_a_link_that_is_not_taken_yet_when_the_list_comes_is_none(team, /, judges):
    (alpha,) = await team.up(team.mission(PROGRAM, ENDLESS), "alpha", admission=judges.admission("alpha"))
    slow = await _looks(team, "bravo", greets=alpha.host.hello())
    await team.until(lambda: slow.heard)
    await _says(team, judges.list(7, judges.who["bravo"].serial))
    await team.until(lambda: slow.over)
    assert "are revoked (list 7)" in slow.refused
    assert not linked(alpha)


@pytest.mark.parametrize("name", ["bravo", "desk"])
async def test_whose_certificate_ends_in_flight_keeps_the_link_to_look_and_stop(team, /, judges, name):
    judges.ends(name, 5.0)
    alpha, _ = await both_up(team, judges, ENDLESS)
    await team.until(lambda: linked(alpha))
    looks, lifts = [await _looks(team, name) for _ in range(2)]
    await asyncio.sleep(30.0)
    assert not looks.over
    lifts.link.send(EmergencyStop(bytes(16), "", lift=True))
    await team.until(lambda: lifts.over)
    assert ("may only observe and stop" if name == "desk" else "a person has it") in lifts.refused
    epoch = alpha.host.core.orders.epochs.hold
    looks.link.send(EmergencyStop(bytes(16), "enough", epoch=epoch))
    await team.until(lambda: looks.over)
    assert f"the certificate of {judges.who[name]} expired" in looks.refused
    assert "EMERGENCY STOP" in alpha.log


async def test_a_list_that_the_authority_has_not_signed_closes_that_link_and_no_other(team, /, judges):
    alpha, _ = await both_up(team, judges, DONE)
    await team.until(lambda: linked(alpha))
    for data in (b"no list", Keyring(judges.ring.folder).revocation_list(9, "a1", at=judges.now)):
        await _says(team, data)
        await team.until(lambda: "link from desk closed: the revocation list" in alpha.log)
    assert linked(alpha)
    assert alpha.host.options.admission.number == 0


async def test_a_revoked_person_may_nothing(team, /, judges):
    await both_up(team, judges, ENDLESS, alpha=judges.list(1, judges.who["desk"].serial))
    with pytest.raises(HandshakeError, match="the keys of desk are revoked"):
        await send_request(team.network.transport("desk"), "alpha:8181", SNAPSHOT)


async def test_a_person_who_was_known_and_whose_certificate_has_ended_may_stop_what_flies(team, /, judges):
    judges.ends("desk", 5.0)
    alpha, _ = await both_up(team, judges, ENDLESS)
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


async def test_a_clock_that_stopped_years_ago_goes_by_what_the_authority_and_the_team_say(team, /, judges):
    mission = team.mission(PROGRAM, DONE)
    old = judges.admission("alpha", begin=0.0)
    (alpha,) = await team.up(mission, "alpha", admission=old)
    assert "system clock behind: it shows 1970-01-01" in alpha.log
    assert "since the certificate of host alpha began then" in alpha.log
    (bravo,) = await team.up(mission, "bravo", admission=judges.admission("bravo"))
    await team.until(lambda: linked(alpha) and linked(bravo))
    assert "since host bravo has sent that time" in alpha.log
    assert abs(old.time.now() - judges.now - LoopClock().monotonic()) < 5.0


class Looker:
    """Keeps its link, and notes how that ends."""

    def __init__(self) -> None:
        self.refused, self.heard, self.over = "", False, False

    def on_message(self, link, message):
        self.heard = True
        link.accept_role("host")
        if isinstance(message, HandshakeRefused):
            self.refused = message.reason

    def on_closed(self, link, error):
        self.over = True


async def _looks(team, name, *words, greets=None):
    """Somebody who has a link to alpha, as an observer; or `greets` so and then says nothing more."""
    looker = Looker()
    looker.link = await team.network.transport(name).connect("alpha:8181", looker)
    for message in (
        msgspec.structs.replace(greets, host=name, incarnation=9) if greets else OBSERVER,
        *words,
    ):
        looker.link.send(message)
    return looker


async def _says(team, data):
    """A person brings a revocation list."""
    return (await _looks(team, "desk", RevocationUpdate(data))).link
