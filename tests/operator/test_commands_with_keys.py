"""Commands over a network: with keys, without keys, without the right, and with damaged keys."""

from __future__ import annotations

import asyncio
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from scripted_snapshots import batch_of

from lfield.authority import keystore
from lfield.authority.certificate_reader import revoked_in
from lfield.authority.identity import Right
from lfield.errors import AddressError, HandshakeError, KeysError
from lfield.net.handshake import Handshake
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.operator import client, observer_link
from lfield.operator.targets import HostRef, TargetTeam
from lfield.testing.keyring import Keyring
from lfield.wire.messages import Hello, RevocationUpdate
from lfield.wire.observer_messages import EmergencyStopResult, Status
from lfield.wire.subscription_messages import Subscribe

LIFT = client.emergency_stop("", lift=True)
SNAPSHOT = batch_of(Status("alpha", "", 0.0, b"", b"", [], [], [], [], []))


class Alpha:
    """A host that answers, and records its messages; each link has a handshake."""

    def __init__(self, name: str = "alpha") -> None:
        self.heard: list[tuple[str, object]] = []
        self.hello = Hello("host", name, 7)
        self._greetings: dict[object, Handshake] = {}

    def called(self, link):
        return self

    def on_message(self, link, message):
        try:
            self._heard(link, message)
        except HandshakeError:
            link.send(self._greetings[link].refusal)
            raise

    def _heard(self, link, message):
        if link not in self._greetings:
            greeting = self._greetings[link] = Handshake(self.hello, link.identity)
            link.send(greeting.first_message())
            link.accept_role(greeting.receive(message).role)
            return
        self._greetings[link].admit(message)
        self.heard.append((str(link.identity), message))
        if not isinstance(message, RevocationUpdate):
            link.send(SNAPSHOT if isinstance(message, Subscribe) else EmergencyStopResult({}))

    def on_closed(self, link, error):
        pass


@pytest.fixture
def ring(tmp_path):
    keyring = Keyring(tmp_path / "keys")
    keyring.give("alpha", "bravo")
    return keyring


def asked(
    ring: Keyring,
    request=client.SNAPSHOT,
    keys: Path | None = None,
    host: Alpha | None = None,
    own="alpha",
):
    """The answers of a host over TCP and of one at a socket."""
    host = host or Alpha()

    async def scenario():
        transport = TcpTransport(1 << 20, TlsIdentity(keystore.read_keys(ring.folder / own, "host")))
        address = f"unix:{ring.folder}/door"
        listeners = [await transport.listen(at, host.called) for at in ("127.0.0.1:0", address)]
        target = TargetTeam((), {"alpha": listeners[0].address, "here": address})
        try:
            answers = await asyncio.to_thread(client.ask_teams, [target], request, keys)
        finally:
            for listener in listeners:
                listener.close()
            await asyncio.sleep(0)
        return answers[HostRef("", "alpha")], answers[HostRef("", "here")]

    return asyncio.run(scenario())


def test_with_keys_a_host_of_another_computer_answers(ring):
    host = Alpha()
    assert asked(ring, keys=ring.folder, host=host)[0] == SNAPSHOT
    assert ("operator", client.SNAPSHOT.message) in host.heard


def test_without_keys_the_error_names_the_remedy(ring, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "nothing"))
    monkeypatch.delenv("LFIELD_KEYS", raising=False)
    over_tcp, _ = asked(ring)
    assert isinstance(over_tcp, KeysError)
    assert "accepts commands only with keys: 'lfield keys person' creates them" in str(over_tcp)


def test_missing_keys_do_not_prevent_a_stop_on_this_computer(ring):
    over_tcp, here = asked(ring, client.emergency_stop("fire"), keys=ring.folder / "nowhere")
    assert "has no keys of a person" in str(over_tcp)
    assert here == EmergencyStopResult({})
    ring.put("me", replace(ring.issue("person", "anna"), key=b"nothing"))
    assert "the keys are damaged" in str(asked(ring, keys=ring.folder)[0])


class Crowded(Alpha):
    """Refuses the first connections, as a host in a flood does."""

    def __init__(self, first: int) -> None:
        super().__init__()
        self.left = first

    def called(self, link):
        self.left -= 1
        if self.left >= 0:
            link.abort()
        return self


def test_a_stop_is_retried_when_connections_are_refused(ring, monkeypatch):
    monkeypatch.setattr(observer_link, "RETRY_DELAY", 0.01)
    assert asked(ring, client.emergency_stop("fire"), ring.folder, Crowded(7))[0] == EmergencyStopResult({})
    assert isinstance(asked(ring, keys=ring.folder, host=Crowded(7))[0], AddressError)
    # A refusal is an answer.
    ring.put("me", ring.issue("person", "anna", Right.OBSERVE))
    host = Alpha()
    assert isinstance(asked(ring, client.emergency_stop("fire"), ring.folder, host)[0], HandshakeError)


def test_without_the_right_to_stop_the_error_names_the_right(ring):
    ring.put("me", ring.issue("person", "anna", Right.OBSERVE))
    assert asked(ring, keys=ring.folder)[0] == SNAPSHOT
    over_tcp, _ = asked(ring, client.emergency_stop("fire"), keys=ring.folder)
    assert "anna may observe, and this takes the right to stop" in str(over_tcp)


def test_a_host_with_the_keys_of_another_gets_no_command(ring):
    over_tcp, _ = asked(ring, keys=ring.folder, own="bravo")
    assert "host bravo calls itself alpha" in str(over_tcp)
    over_tcp, _ = asked(ring, keys=ring.folder, own="bravo", host=Alpha("bravo"))
    assert "bravo answered at the address of alpha" in str(over_tcp)


async def test_a_host_may_stop_a_host_with_another_bundle_of_its_authority(ring):
    """A stop names no bundle; different bundles matter to the handshake of hosts."""
    host = Alpha()
    host.hello = Hello("host", "alpha", 7, b"p" * 32, b"d" * 32)

    transport = TcpTransport(1 << 20, TlsIdentity(keystore.read_keys(ring.folder / "alpha", "host")))
    listener = await transport.listen("127.0.0.1:0", host.called)
    bravo = client.observer_transport(keystore.read_keys(ring.folder / "bravo", "host"))
    places = {"alpha": listener.address}
    answers = [await client.ask_all(bravo, places, what) for what in (client.emergency_stop("fire"), LIFT)]
    listener.close()
    stopped, lifted = [answer["alpha"] for answer in answers]
    assert stopped == EmergencyStopResult({})
    assert "a person has it, not a host" in str(lifted)


def test_a_command_brings_the_revocation_list_along(ring):
    ring.put(
        "me", replace(ring.issue("person", "anna", Right.OBSERVE), revoked=ring.revocation_list(3, "ff"))
    )
    host = Alpha()
    asked(ring, keys=ring.folder, host=host)
    (brought,) = [
        expected
        for caller, expected in host.heard
        if isinstance(expected, RevocationUpdate) and caller == "anna"
    ]
    assert revoked_in(brought.list, ring.issue("host", "x").authority).number == 3


@pytest.fixture
def other_user(monkeypatch):
    """A user outside the group lfield who runs the host."""
    monkeypatch.setattr("lfield.net.peer_credentials._group_id", lambda: 900)
    return 12347


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can run what is another user's")
@pytest.mark.parametrize(
    "request_", [client.SNAPSHOT, client.emergency_stop("fire"), LIFT, client.pause(lift=True)]
)
def test_root_reaches_a_host_that_another_user_runs(other_user, request_):
    assert asked_of(other_user, request_) in (SNAPSHOT, EmergencyStopResult({}))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can run what is another user's")
def test_a_user_does_not_trust_a_host_of_a_third_user(other_user, monkeypatch):
    real = os.geteuid
    monkeypatch.setattr("lfield.net.peer_credentials.os.geteuid", lambda: real() or 1001)
    messages: list[object] = []
    answer = asked_of(other_user, client.emergency_stop("fire"), messages)
    assert isinstance(answer, HandshakeError)
    assert str(answer) == (
        "handshake refused: the host is run by user 12347 of this computer, and a command trusts only "
        "its own user, root, and the group 'lfield': use sudo, if it is a host of yours"
    )
    assert messages == []
    for believed in (0, 1001):
        assert asked_of(believed, client.SNAPSHOT) == SNAPSHOT


def asked_of(user: int, request, heard: list[object] | None = None):
    """The answer of a host of this user: the kernel reports the user of the listening process."""
    host = Alpha()

    async def scenario(address: str):
        transport = TcpTransport(1 << 20)
        os.seteuid(user)
        try:
            listener = await transport.listen(address, host.called)
        finally:
            os.seteuid(0)
        try:
            return (await client.ask_all(transport, {"alpha": listener.address}, request))["alpha"]
        finally:
            listener.close()

    # The folder of a test is private to its user.
    with tempfile.TemporaryDirectory() as folder:
        os.chown(folder, user, -1)
        answer = asyncio.run(scenario(f"unix:{folder}/door"))
    if heard is not None:
        heard += [message for _, message in host.heard]
    return answer


def test_an_internal_error_is_raised_and_not_retried(ring, monkeypatch):
    """A retry, as for an unreachable host, would hide the error."""
    host, called = Alpha(), []
    host.called = lambda link: called.append(link) or host

    def clipped_badly(reason: str) -> str:
        return reason + "\udcff"

    monkeypatch.setattr(client, "truncate", clipped_badly)
    with pytest.raises(UnicodeEncodeError):
        asked(ring, client.emergency_stop("fire"), ring.folder, host)
    assert len(called) == 2
