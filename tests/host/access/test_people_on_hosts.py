"""Rights of persons on real hosts: a mission may limit their certificates, but never the stop."""

from __future__ import annotations

import time

import memory_network
import msgspec
import pytest

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.identity import ALL_RIGHTS, NO_RIGHTS, Identity
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import SystemClock
from lfield.errors import HandshakeError
from lfield.operator.client import SNAPSHOT, emergency_stop, pause
from lfield.operator.observer_link import send_request
from lfield.testing.keyring import Keyring
from lfield.wire.messages import Hello
from lfield.wire.observer_messages import EmergencyStopResult

PROGRAM = """
resource Echo { init(string[] arg) { } portal say() { sleep(1.0); } }
coordinator Caller { init(string[] arg) { while (true) findEcho("echo").say(); } }
"""
ALONE = "//Caller:tom@alpha\n//Echo:echo@alpha\n"
PEOPLE = """\
people:
  anna: [observe, stop]
  bob: []
"""


@pytest.fixture
def named(monkeypatch, tmp_path):
    """`named()`: the admission of a host, where each address names its peer."""

    def at(address: str) -> Identity:
        name, now = address.partition(":")[0], time.time()
        kind, may = ("host", NO_RIGHTS) if name == "alpha" else ("person", ALL_RIGHTS)
        return Identity(kind, name, may, name, now - 1000.0, now + 1000.0, "ours")

    monkeypatch.setattr(memory_network, "host_at_address", at)

    def admission() -> CertificateAdmission:
        return CertificateAdmission(
            Keyring(tmp_path).issue("host", "alpha"), at("alpha"), TrustedClock(SystemClock())
        )

    return admission


async def up(team, named, access):
    mission = team.mission(PROGRAM, ALONE, access=access)
    (alpha,) = await team.up(mission, "alpha", admission=named())
    return alpha


async def asked(team, who, request):
    return await send_request(team.network.transport(who), "alpha:8181", request)


async def test_a_limited_person_gets_the_line_of_the_rule_and_may_still_stop(team, /, named):
    alpha = await up(team, named, PEOPLE)
    assert (await asked(team, "anna", SNAPSHOT)).snapshot.host == "alpha"
    reason = "anna may not operate in this mission: mission.access.yaml:2 limits anna to: observe, stop"
    with pytest.raises(HandshakeError, match=reason):
        await asked(team, "anna", pause(lift=True))
    with pytest.raises(
        HandshakeError, match=r"bob may not observe in this mission: .*:3 limits bob to: nothing"
    ):
        await asked(team, "bob", SNAPSHOT)
    assert isinstance(await asked(team, "bob", emergency_stop("fog")), EmergencyStopResult)
    assert "fog" in alpha.log


FORGED = "fire\nalpha | bravo is safe"


async def test_a_text_cannot_imitate_another_log_line(team, /, named):
    program = PROGRAM.replace("while (true)", 'print("out\\nalpha is up"); while (true)')
    mission = team.mission(program, ALONE)
    (alpha,) = await team.up(mission, "alpha", admission=named())
    await asked(team, "anna", emergency_stop(FORGED))
    await team.until(lambda: "out\n" in alpha.log)
    assert "EMERGENCY STOP by anna: fire\\nalpha | bravo is safe\n" in alpha.log
    assert "tom: out\n    alpha is up\n" in alpha.log
    assert alpha.host.core.coordinators.stopped == "fire\\nalpha | bravo is safe"


async def test_a_person_without_a_line_has_the_rights_of_the_certificate(team, /, named):
    await up(team, named, PEOPLE)
    await asked(team, "carl", pause())
    await asked(team, "carl", pause(lift=True))


async def test_the_line_others_applies_to_persons_without_a_line(team, /, named):
    await up(team, named, PEOPLE + "  others: [stop]\n")
    with pytest.raises(HandshakeError, match=r"carl may not operate .*:4 limits others to: stop"):
        await asked(team, "carl", emergency_stop("", lift=True))


class HelloClient:
    """A client that keeps the Hello of the host."""

    def __init__(self) -> None:
        self.hello: Hello | None = None

    def on_message(self, link, message):
        self.hello = self.hello or message

    def on_closed(self, link, error):
        pass


async def test_a_hello_tells_mission_data_only_to_hosts_of_the_mission(team, /, named):
    """An observer has to ask, with a right that this mission may remove."""
    alpha = await up(team, named, PEOPLE)
    for name in ("bob", "anna"):
        client = HelloClient()
        await team.network.transport(name).connect("alpha:8181", client)
        await team.until(lambda client=client: client.hello)
        own = alpha.host.hello()
        received = msgspec.structs.replace(client.hello, time=0.0)
        # A person needs the epochs for an order to stop.
        assert received == Hello("host", "alpha", own.incarnation, epochs=own.epochs)
        assert own.coordinators
