"""Peers that call a host in the matrix, and a host that records the accepted messages."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from certificates import Team, made
from link_attacker import ANSWER, TOKEN, Attacker, context, repeated, send_messages
from msgspec.structs import replace
from socket_users import SocketUser, Users

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.certificate_reader import revoked_in
from lfield.authority.identity import Right, uri_of
from lfield.authority.key_material import Keys
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.hybrid_clock import HybridClock
from lfield.mission.access.access_rules import Access, PersonRule
from lfield.net.link_manager import LinkManager
from lfield.net.link_owner import TeamAddresses
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.net.transport import Link
from lfield.wire.codec import encode, encode_transfer
from lfield.wire.coordinator_messages import Terminated, Transfer
from lfield.wire.messages import (
    AgentUpdate,
    Control,
    DirectoryUpdate,
    Hello,
    Message,
    Ping,
    RevocationUpdate,
    Role,
)
from lfield.wire.observer_messages import (
    EmergencyStop,
    ForgetRequest,
    InputLine,
    Pause,
    RecoverRequest,
    StartRequest,
)
from lfield.wire.person_calls.portal_call_messages import PortalCallRequest
from lfield.wire.quorum_messages import Propose
from lfield.wire.reservation_messages import RenewReservation
from lfield.wire.subscription_messages import Subscribe

#: Seconds since 1970 UTC: the certificates of `Team` are from 2026 to 2099.
NOW = 1_795_464_000.0
HOSTS, ADDRESSES = ("alpha", "bravo", "charlie"), ("127.0.0.1:1", "127.0.0.1:2", "127.0.0.1:3")
OWN = Hello("host", "alpha", 7, b"p" * 32, b"d" * 32, 1 << 16, bundle=b"b" * 32)
BLOCK = b"block"
HOP = Transfer("tom", 1, 2, 3, b"p" * 32, 7, len(BLOCK))
#: Messages by column: those that only hosts send, and those of commands.
SAID_BY_HOSTS: dict[str, Message] = {
    "ended": Terminated("tom", 1, "done", "", "bravo"),
    "report": DirectoryUpdate(9, 0, 1, [AgentUpdate(0, "", None, [], [])]),
    "bar": Propose("tom", 9),
    "renew": RenewReservation("arm", 1, "tom", 1),
}
ID = bytes(16)
SAID_BY_COMMANDS: dict[str, Message] = {
    "ps": Subscribe(once=True),
    "watch": Subscribe(),
    "estop": EmergencyStop(ID, "why"),
    "lift": EmergencyStop(ID, "", lift=True),
    "pause": Pause(ID),
    "resume": Pause(ID, lift=True),
    "forget": ForgetRequest("tom"),
    "recover": RecoverRequest("tom", 1, 2, 3),
    "start": StartRequest(["bravo"]),
    "type": InputLine("echo", "yes"),
    "call": PortalCallRequest(ID, 1, "echo", "say", b"\x90", 1.0),
}
#: The rules of the mission for persons.
RULES = Access("mission.access.yaml", (PersonRule("maria", (Right.OBSERVE,), 2), PersonRule("nina", (), 3)))


class RecordingHost:
    """A host without agents, which records the messages that its links accept."""

    def __init__(self) -> None:
        self.hybrid_clock = HybridClock(0.0, 0.0)
        self.linked_with: list[str] = []
        self.done: list[object] = []

    def hello(self) -> Hello:
        return OWN

    def on_linked(self, hello: Hello) -> None:
        self.linked_with.append(hello.host)

    def on_unlinked(self, host: str, *, quietly: bool) -> None:
        pass

    def desired_hosts(self) -> tuple[str, ...]:
        return ()

    def on_message(self, host: str, message: Control, link: Link) -> None:
        # Messages between hosts count from a host only, and a host sends no commands.
        if bool(host) == (message in SAID_BY_HOSTS.values()):
            self.done.append(message)
            link.send(ANSWER)

    def on_transfer(self, host: str, header: Transfer, block: memoryview) -> None:
        self.done.append(header)

    def on_oversize(self, host: str, header: Transfer, size: int) -> None:
        self.done.append(header)

    def note(self, text: str) -> None:
        pass

    def forget(self) -> None:
        """Clear the record."""
        self.linked_with.clear()
        self.done.clear()


@dataclass(frozen=True)
class Caller:
    """The certificate of a peer and its claimed name. `keys` None: no certificate; `tls` False: no TLS.

    A peer with `replays` opens a valid link, and then sends the same bytes on another link.
    """

    keys: Keys | None
    calls_itself: str = "bravo"
    tls: bool = True
    program: bytes = OWN.program
    release: bytes = OWN.bundle
    bent: Callable[[int, bytes], bytes] = lambda number, data: data
    replays: bool = False

    def hello(self, role: Role, name: str = "") -> Hello:
        """The Hello of the peer: as a host it matches the called host; a command states no mission."""
        if role == "observer":
            return Hello("observer", name or "observer", 99)
        return replace(
            OWN, host=name or self.calls_itself, incarnation=99, program=self.program, bundle=self.release
        )


@dataclass(frozen=True)
class LinkFate:
    """An event on an open link: the certificate `ends`, or a revocation list arrives."""

    ends: bool
    flies: bool


class Network:
    """A team, another team, and all peers that call host alpha of the first."""

    def __init__(self) -> None:
        self.team, self.other = Team(), Team()
        self.alpha = self.team.host("alpha")
        self._tls, self._authority = TlsIdentity(self.alpha), self.team.authority.certificate
        self._revoked = (self.team.host("bravo"), self.team.person("carl", *Right))
        self.none = self.team.revoked(0)
        self.list = self.team.revoked(1, *self._revoked)
        self.newer = self.team.revoked(2, *self._revoked)
        self.forged = self.other.revoked(9, self.alpha)

    @cached_property
    def callers(self) -> dict[str, Caller]:
        """The rows."""
        team, ended = self.team, NOW - 60.0
        person = team.person
        alone = made("bravo", [uri_of("host", "bravo")])
        return {
            "host": Caller(team.host("bravo")),
            "later": Caller(team.host("bravo")),
            "bundle": Caller(team.host("bravo"), program=b"q" * 32),
            "bindings": Caller(team.host("bravo"), release=b"c" * 32),
            "files": Caller(team.host("bravo"), release=b""),
            "outsider": Caller(team.host("delta"), "delta"),
            "named": Caller(team.host("charlie")),
            "ended": Caller(team.host("bravo", end=ended)),
            "revoked": Caller(self._revoked[0]),
            "foreign": Caller(self.other.host("bravo")),
            "selfsigned": Caller(team.with_(alone)),
            "nameless": Caller(team.unusual()),
            "twofold": Caller(team.unusual(uri_of("host", "bravo"), uri_of("host", "charlie"))),
            "page": Caller(team.page()),
            "browsers": Caller(team.browsers()),
            "bare": Caller(None),
            "plain": Caller(None, tls=False),
            "replay": Caller(team.host("bravo"), replays=True),
            "bent": Caller(team.host("bravo"), bent=_bent),
            "observer": Caller(person("anna", Right.OBSERVE)),
            "stopper": Caller(person("anna", Right.OBSERVE, Right.STOP)),
            "operator": Caller(person("anna", Right.OBSERVE, Right.STOP, Right.OPERATE)),
            "commander": Caller(person("anna", Right.COMMAND)),
            "everything": Caller(person("anna", *Right)),
            "namesake": Caller(person("bravo", *Right)),
            "narrowed": Caller(person("maria", *Right)),
            "left": Caller(person("nina", *Right)),
            "person_ended": Caller(person("anna", *Right, end=ended)),
            "person_revoked": Caller(self._revoked[1]),
            "person_foreign": Caller(self.other.person("anna", *Right)),
        }

    def tried(self, who: str, what: str) -> bool:
        """Whether a host accepted the action over the network."""
        return any(asyncio.run(self._try(self.callers[who], what, role)) for role in _roles(what))

    def tried_at_socket(self, users: Users, who: str, what: str) -> bool:
        """Whether a host accepted the action of a local user at its socket, also by lfield's commands."""
        with users.at_socket(who, self._rehearse) as user:
            done = any(asyncio.run(self._try_at_socket(user, what, role)) for role in _roles(what))
            if what in SAID_BY_COMMANDS:
                by_command = asyncio.run(self._try_at_socket(user, what, None))
                assert by_command == done, "each right has its command"
            return done

    def _rehearse(self, user: SocketUser) -> None:
        for role in (*_roles("ps"), None):
            assert asyncio.run(self._try_at_socket(user, "ps", role)) == (role != "host")

    def tried_on_a_link(self, who: str, what: str) -> bool:
        """Whether a host accepted the action on a link whose certificate expired or was revoked later."""
        kind, event, state = who.split("_")
        caller = self.open_link_callers[kind, event]
        link_state = LinkFate(event == "ended", flies=state == "flies")
        return asyncio.run(self._try(caller, what, "host" if kind == "host" else "observer", link_state))

    @cached_property
    def open_link_callers(self) -> dict[tuple[str, str], Caller]:
        """Peers with an open link, by type and by the later event of their certificate."""
        team, end = self.team, NOW + 60.0
        bravo, carl = (Caller(keys) for keys in self._revoked)
        ends = Caller(team.host("bravo", end=end))
        return {
            ("host", "revoked"): bravo,
            ("host", "ended"): ends,
            ("host", "other"): Caller(team.host("bravo")),
            ("looks", "revoked"): bravo,
            ("looks", "ended"): ends,
            ("person", "revoked"): carl,
            ("person", "ended"): Caller(team.person("carl", *Right, end=end)),
            ("person", "other"): Caller(team.person("carl", *Right)),
        }

    async def _try(self, caller: Caller, what: str, role: Role, fate: LinkFate | None = None) -> bool:
        """Open a link in a role and send one message; returns whether the action was accepted.

        A `fate` occurs between the Hello and the message.
        """
        noted, clock = RecordingHost(), ManualClock(NOW)
        admission = self._admission(clock, self.list if fate is None else self.none)
        peers = self._peers(noted, clock, admission)
        address = await peers.open("127.0.0.1:0")
        try:
            words = self._messages_for(caller.hello(role, "charlie" if what == "other" else ""), what)
            between = None if fate is None else partial(self._apply_fate, fate, admission, clock, peers)
            attacker = Attacker(context(caller.keys) if caller.tls else None, caller.bent)
            await send_messages(attacker, address, words, between)
            if caller.replays:
                noted.forget()
                admission.revoked, admission.list = revoked_in(self.list, self._authority), self.list
                admission.number = admission.revoked.number
                attacker = await repeated(address, attacker.sent)
            return self._was_accepted(what, attacker.received, noted, admission)
        finally:
            peers.close()

    async def _try_at_socket(self, user: SocketUser, what: str, role: Role | None) -> bool:
        """Send one message as a local user; without a role by a command of lfield."""
        noted, clock = RecordingHost(), ManualClock(NOW)
        admission = self._admission(clock, self.list)
        peers = self._peers(noted, clock, admission)
        await user.listen(peers)
        try:
            if role is None:
                message = SAID_BY_COMMANDS[what]
                return await user.asked(message) and message in noted.done
            hello = Caller(None).hello(role, "charlie" if what == "other" else "")
            return self._was_accepted(
                what, await user.send(self._messages_for(hello, what)), noted, admission
            )
        finally:
            peers.close()

    def _admission(self, clock: ManualClock, data: bytes) -> CertificateAdmission:
        revoked = revoked_in(data, self._authority)
        admission = CertificateAdmission(
            self.alpha, self._tls.own_identity(), TrustedClock(clock), revoked, data
        )
        admission.denied_rights = RULES.denied_rights
        return admission

    def _peers(
        self, noted: RecordingHost, clock: ManualClock, admission: CertificateAdmission
    ) -> LinkManager:
        transport = TcpTransport(1 << 16, self._tls)
        team = TeamAddresses({host: number for number, host in enumerate(HOSTS)}, ADDRESSES, 0, ())
        return LinkManager(noted, transport, clock, random.Random(1), team, admission)

    def _apply_fate(
        self, fate: LinkFate, admission: CertificateAdmission, clock: ManualClock, peers: LinkManager
    ) -> None:
        """Let a certificate expire, or a revocation list arrive."""
        admission.is_mission_active = lambda: fate.flies
        if fate.ends:
            clock.advance(120.0)
        else:
            assert admission.on_revocation_list(self.list)
        peers.reauthorise()

    def _messages_for(self, hello: Hello, what: str) -> list[bytes]:
        frames = [encode(hello)]
        if what == "hop":
            frames.append(encode_transfer(HOP, BLOCK) + BLOCK)
        elif what in ("list", "forged"):
            frames.append(encode(RevocationUpdate(self.newer if what == "list" else self.forged)))
        elif what in SAID_BY_HOSTS or what in SAID_BY_COMMANDS:
            frames.append(encode({**SAID_BY_HOSTS, **SAID_BY_COMMANDS}[what]))
        return [*frames, encode(Ping(TOKEN))]

    def _was_accepted(
        self, what: str, received: Sequence[Message], noted: RecordingHost, admission: CertificateAdmission
    ) -> bool:
        if what == "hear":
            return any(isinstance(message, Hello) for message in received)
        if what == "mission":
            return any(isinstance(message, Hello) and message.program for message in received)
        if what == "other":
            return "charlie" in noted.linked_with
        if what in ("list", "forged"):
            return admission.number == (2 if what == "list" else 9)
        expected = HOP if what == "hop" else {**SAID_BY_HOSTS, **SAID_BY_COMMANDS}[what]
        return expected in noted.done


def _roles(what: str) -> tuple[Role, ...]:
    return ("host",) if what == "other" else ("host", "observer")


def _bent(number: int, data: bytes) -> bytes:
    """Change one bit of the first message after the handshake, which has at most three pieces."""
    return data[:-9] + bytes([data[-9] ^ 1]) + data[-8:] if number == 2 else data
