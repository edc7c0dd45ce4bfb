"""Handshake of a link (Hello messages): a sans-IO state machine that checks identity and compatibility.

Both sides send `Hello` at once. A side that rejects the Hello of the other answers with `HandshakeRefused`,
so that both logs have the same reason, and closes the link. TLS or the kernel has already authenticated the
peer; the names in `Hello` must agree with that identity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from lfield.authority.peer_verification import ALLOWED, AdmissionDecision
from lfield.authority.rights import missing_permission
from lfield.errors import HandshakeError, WireError
from lfield.wire.fields import short_digest
from lfield.wire.messages import PROTOCOL, HandshakeRefused, Hello, IncompatibleHello

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from lfield.authority.identity import Identity
    from lfield.wire.messages import Message


class Handshake:
    """The handshake of one link, as seen from one side.

    `own` is the Hello of this side, `identity` the authenticated peer, and `decision` its present
    authorisation, replaced when it is reassessed. `hosts` are the names in the deployment, `linked` the
    incarnations of the hosts with a live link when `own` was made: the link of an earlier incarnation of the
    peer must be closed, since `own` does not include the messages that it may still send. `dialled` is the
    name of the dialled host; None on the accepting side. An observer (`own.role`) has no deployment: it
    passes no hosts and accepts any host.

    Send `first_message`, pass every message to `receive` until `peer` is set, and later ones to `admit`. When
    one of them raises an error, send `refusal`, if any, and close the link with the error.
    """

    def __init__(
        self,
        own: Hello,
        identity: Identity,
        *,
        decision: AdmissionDecision = ALLOWED,
        hosts: Collection[str] = (),
        linked: Mapping[str, int] | None = None,
        dialled: str | None = None,
    ) -> None:
        self.own, self.identity, self.decision = own, identity, decision
        self.peer: Hello | None = None
        self.refusal: HandshakeRefused | None = None
        #: The bundle of a refused peer; b"" if the peer has none or the bundle is unknown.
        self.refused_bundle = b""
        self._hosts, self._dialled = hosts, dialled
        self._linked: Mapping[str, int] = {} if linked is None else linked

    def reauthorise(self, decision: AdmissionDecision) -> None:
        """Replace the authorisation of the peer."""
        self.decision = decision

    def first_message(self) -> Hello:
        """The first message. Raises HandshakeError if the peer must receive no data of this host."""
        identity = self.identity
        if identity.kind == "anonymous":
            self._refuse("unknown certificate authority: hosts and operators have keys from 'lfield keys'")
        if identity.kind == "local" and not identity.may:
            self._refuse(
                f"the host is run by {identity}, and a command trusts only its own user, root, and the group "
                "'lfield': use sudo, if it is a host of yours"
                if self.own.role == "observer"
                else f"{identity} has no permission here: join the group 'lfield', which may observe and "
                "stop, or use sudo"
            )
        if self.decision.extent == "nothing":
            self._refuse(self.decision.reason)
        return self.own if identity.kind == "host" else self.own.summary

    def receive(self, message: Message) -> Hello:
        """The peer's accepted Hello. Raises HandshakeError, and WireError for any other message."""
        if isinstance(message, HandshakeRefused):
            raise HandshakeError(f"{self._dialled or 'the peer'} refused the connection: {message.reason}")
        if isinstance(message, IncompatibleHello):
            self._refuse(
                f"{self.own.host} uses protocol {PROTOCOL} and its peer protocol {message.protocol}; "
                "install the same version of lfield on both"
            )
        if not isinstance(message, Hello) or message.role == "standby":
            raise WireError(f"received {type(message).__name__} before the handshake")
        self._check_identity(message)
        if "observer" not in (self.own.role, message.role):
            self._check_name(message)
        self._check_mission(message)
        self._check_devices(message)
        self._check_journal(message)
        self._check_recovery(message)
        self._check_origin(message)
        self._check_reservation(message)
        self.peer = message
        return message

    def admit(self, message: Message) -> None:
        """Check a message after the handshake. Raises WireError for a message that is invalid there,
        HandshakeError for a message that the peer has no permission to send.
        """
        if isinstance(message, Hello | IncompatibleHello):
            raise WireError("received a second Hello on one link")
        if self.peer is None:
            raise WireError(f"received {type(message).__name__} before the handshake")
        if self.peer.role == "observer" and (
            reason := missing_permission(self.identity, self.decision, message)
        ):
            self.refusal = HandshakeRefused(reason)
            raise HandshakeError(reason)

    def _check_identity(self, hello: Hello) -> None:
        """The claimed identity must not exceed the authenticated one."""
        identity = self.identity
        if hello.role == "observer" or (self.own.role == "observer" and identity.kind == "local"):
            return
        if identity.kind != "host":
            self._refuse(
                f"{self.own.host} accepts hosts by certificate, and {identity} may only send commands"
            )
        if identity.name != hello.host:
            self._refuse(
                f"{identity} calls itself {hello.host}; the name in its certificate must be its name in the "
                f"deployment: 'lfield keys host {hello.host}' makes one"
            )
        if self.own.role == "observer" and self._dialled not in (None, hello.host):
            self._refuse(
                f"{hello.host} answered at the address of {self._dialled}; correct the address",
                answered_by=hello.host,
            )

    def _check_name(self, hello: Hello) -> None:
        name = hello.host
        if name == self.own.host:
            if hello.incarnation == self.own.incarnation:
                self._refuse(f"{name} reached itself; give every host of the deployment its own address")
            self._refuse(f"two hosts call themselves {name}; start one of them under another --host name")
        if name not in self._hosts:
            self._refuse(
                f"the deployment of {self.own.host} has no host {name}; use the same .dL file on both"
            )
        if self._dialled is not None and name != self._dialled:
            self._refuse(
                f"{name} answered at the address of {self._dialled}; correct the address or the --map",
                answered_by=name,
            )
        if self._linked.get(name, hello.incarnation) != hello.incarnation:
            self._refuse(
                f"{self.own.host} already has a link to another {name}; stop one of the two, or try again "
                "when the old link has ended"
            )

    def _check_mission(self, hello: Hello) -> None:
        """All hosts of a team run the same bundle, or equal parts of it if built locally from files.
        Operators compare bundles, so the message has both digests if there are two.
        """
        if "observer" in (self.own.role, hello.role):
            return
        part_name, remedy = self._first_difference(hello)
        is_other_bundle = self.own.bundle and hello.bundle and self.own.bundle != hello.bundle
        if not (part_name or is_other_bundle):
            return
        self.refused_bundle = peer_bundle = hello.bundle or hello.built
        own_bundle = self.own.bundle or self.own.built
        if own_bundle and peer_bundle and own_bundle != peer_bundle:
            difference = f", which differ in their {part_name}" if part_name else ""
            self._refuse(
                f"{self.own.host} runs bundle {short_digest(own_bundle)} and {hello.host} runs bundle "
                f"{short_digest(peer_bundle)}{difference}: copy one of the two to both, and give a robot "
                "what is its own with --devices"
            )
        self._refuse(remedy)

    def _first_difference(self, hello: Hello) -> tuple[str, str]:
        """The first part of the mission that differs, and its description; '' for none."""
        pairs = (
            ("program", self.own.program, hello.program, "the same program file"),
            ("deployment", self.own.deployment, hello.deployment, "the same .dL file"),
            (
                "registry",
                self.own.registry,
                hello.registry,
                "the same .capabilities.yaml file and the same version of lfield",
            ),
            ("access rules", self.own.access, hello.access, "the same .access.yaml file"),
        )
        for part, own_digest, peer_digest, source in pairs:
            if own_digest != peer_digest:
                return part, (
                    f"{self.own.host} has {part} {own_digest.hex()[:12] or '(none)'} and {hello.host} has "
                    f"{part} {peer_digest.hex()[:12] or '(none)'}; start both from {source}, or from "
                    "one bundle"
                )
        return "", ""

    def _check_devices(self, hello: Hello) -> None:
        """Simulated devices must not be mixed with real ones."""
        worlds = {self.own.devices, hello.devices} - {""}
        if len(worlds) > 1:
            self._refuse(
                f"the devices of {self.own.host} are {self.own.devices} and those of {hello.host} are "
                f"{hello.devices}; start both with --sim, or none"
            )

    def _check_journal(self, hello: Hello) -> None:
        """A host with a journal must not transfer state to a host without one."""
        if "observer" in (self.own.role, hello.role) or bool(self.own.journal_id) == bool(hello.journal_id):
            return
        keeps, other = (self.own.host, hello.host) if self.own.journal_id else (hello.host, self.own.host)
        self._refuse(
            f"{keeps} keeps its coordinators in a journal and {other} does not; start both with "
            "--volatile, or none; under --sim both with --state, or none"
        )

    def _check_recovery(self, hello: Hello) -> None:
        """Majorities of different member sets need not intersect."""
        if "observer" not in (self.own.role, hello.role) and self.own.recovery != hello.recovery:
            own_members, peer_members = self.own.recovery or "no host", hello.recovery or "no host"
            self._refuse(
                f"on {self.own.host} coordinators are recovered by {own_members} and on {hello.host} by "
                f"{peer_members}; give both the same 'recovery' in their devices files"
            )

    def _check_origin(self, hello: Hello) -> None:
        """Different map origins send a device to different places."""
        if "observer" not in (self.own.role, hello.role) and self.own.origin != hello.origin:
            own_origin, peer_origin = (
                f"from {origin}" if origin else "from each home" for origin in (self.own.origin, hello.origin)
            )
            self._refuse(
                f"{self.own.host} counts places {own_origin} and {hello.host} {peer_origin}; give both the "
                "same 'frame: {origin: ...}' in their devices files"
            )

    def _check_reservation(self, hello: Hello) -> None:
        """A host that renews too rarely for the others would lose its reservations."""
        if "observer" not in (self.own.role, hello.role) and self.own.reservation != hello.reservation:
            self._refuse(
                f"reservations of {self.own.host} last {self.own.reservation:g} s without contact, those of "
                f"{hello.host} {hello.reservation:g} s; give both the same 'reservations: {{lease: ...}}' in "
                "their devices files"
            )

    def _refuse(self, reason: str, *, answered_by: str = "") -> NoReturn:
        self.refusal = HandshakeRefused(reason)
        raise HandshakeError(f"handshake refused: {reason}", answered_by=answered_by)
