"""Who may be talked to: the rules of the first message on a link, as a pure state machine.

Both sides send their `Hello` at once. Whoever finds the other's unfit answers with `Refuse`, so that the
same sentence is in both logs, and closes. Who the other is was proven before, by TLS or by the kernel; what
it says of itself must be that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from lfield.authority.judge import ALL_IS_WELL, Verdict
from lfield.authority.rights import lacks
from lfield.errors import GreetingError, WireError
from lfield.wire.fields import short_digest
from lfield.wire.messages import PROTOCOL, ForeignHello, Hello, Refuse

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from lfield.authority.identity import Identity
    from lfield.wire.messages import Message


class Greeting:
    """The greeting of one link, seen from one side.

    `own` is the Hello of this side, `who` is at the other end, and `verdict` what that one is good for now:
    whoever judges the link again puts the new one there. `hosts` are the names of the deployment, `linked`
    the hosts that have a live link here, by name, with their incarnations. Both are of the moment of `own`:
    what an earlier life of the peer may yet send on its link is not in `own`, so that link must be gone.
    `dialled` is the name of the host this side called; None on the side that was called. An observer
    (`own.role`) knows no deployment: it passes no hosts and takes any.

    Send what `begin` gives, feed every message to `receive` until `peer` is set, each later one to `admit`.
    When one raises, send `refusal`, if there is one, and let the error close the link.
    """

    def __init__(
        self,
        own: Hello,
        who: Identity,
        *,
        verdict: Verdict = ALL_IS_WELL,
        hosts: Collection[str] = (),
        linked: Mapping[str, int] | None = None,
        dialled: str | None = None,
    ) -> None:
        self.own, self.who, self.verdict = own, who, verdict
        self.peer: Hello | None = None
        self.refusal: Refuse | None = None
        #: The bundle of a peer whose greeting did not fit, b"" where it has none or did not say.
        self.refused_bundle = b""
        self._hosts, self._dialled = hosts, dialled
        self._linked: Mapping[str, int] = {} if linked is None else linked

    def begin(self) -> Hello:
        """What to send first. Raises GreetingError where the other is to hear nothing of this host."""
        who = self.who
        if who.kind == "stranger":
            self._refuse("nobody here knows who this is; hosts and people have keys of 'lfield keys'")
        if who.kind == "local" and not who.may:
            self._refuse(
                f"what answers here is run by {who}, and a command believes its own user, root, and the "
                "group 'lfield': use sudo, if that is a host of yours"
                if self.own.role == "observer"
                else f"{who} may nothing here: join the group 'lfield', which may look and stop, or use sudo"
            )
        if self.verdict.extent == "nothing":
            self._refuse(self.verdict.why)
        return self.own if who.kind == "host" else self.own.brief

    def receive(self, message: Message) -> Hello:
        """The peer's Hello, if it fits. Raises GreetingError, and WireError for anything but a greeting."""
        if isinstance(message, Refuse):
            raise GreetingError(f"{self._dialled or 'the peer'} refused this host: {message.reason}")
        if isinstance(message, ForeignHello):
            self._refuse(
                f"{self.own.host} speaks protocol {PROTOCOL} and its peer protocol {message.protocol}; "
                "install the same version of lfield on both"
            )
        if not isinstance(message, Hello):
            raise WireError(f"a {type(message).__name__} came before the greeting")
        self._check_identity(message)
        if "observer" not in (self.own.role, message.role):
            self._check_name(message)
        self._check_mission(message)
        self._check_devices(message)
        self._check_memory(message)
        self._check_recovery(message)
        self._check_origin(message)
        self._check_reservation(message)
        self.peer = message
        return message

    def admit(self, message: Message) -> None:
        """Raises WireError for a message that nobody sends after the greeting, GreetingError for one that the
        peer may not send."""
        if isinstance(message, Hello | ForeignHello):
            raise WireError("a second greeting came on one link")
        if self.peer is None:
            raise WireError(f"a {type(message).__name__} came before the greeting")
        if self.peer.role == "observer" and (why := lacks(self.who, self.verdict, message)):
            self.refusal = Refuse(why)
            raise GreetingError(why)

    def _check_identity(self, hello: Hello) -> None:
        """What somebody calls itself is no more than what it has proven."""
        who = self.who
        if hello.role == "observer" or (self.own.role == "observer" and who.kind == "local"):
            return
        if who.kind != "host":
            self._refuse(f"{self.own.host} takes hosts by their certificates, and {who} only gives commands")
        if who.name != hello.host:
            self._refuse(
                f"{who} calls itself {hello.host}; the name in its certificate must be its name in the "
                f"deployment: 'lfield keys host {hello.host}' makes one"
            )
        if self.own.role == "observer" and self._dialled not in (None, hello.host):
            self._refuse(f"{hello.host} answered at the address of {self._dialled}; correct the address")

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
                f"{name} answered at the address of {self._dialled}; correct the address or the --map"
            )
        if self._linked.get(name, hello.incarnation) != hello.incarnation:
            self._refuse(
                f"{self.own.host} already has a link to another {name}; stop one of the two, or try again "
                "when the old link is gone"
            )

    def _check_mission(self, hello: Hello) -> None:
        """All hosts of a team run the same bundle, or at least the same of each part where they have built
        their own of files. People compare bundles, so both digests are named wherever there are two."""
        if "observer" in (self.own.role, hello.role):
            return
        different, remedy = self._first_difference(hello)
        is_other_bundle = self.own.bundle and hello.bundle and self.own.bundle != hello.bundle
        if not (different or is_other_bundle):
            return
        self.refused_bundle = theirs = hello.bundle or hello.built
        ours = self.own.bundle or self.own.built
        if ours and theirs and ours != theirs:
            part = f", which differ in their {different}" if different else ""
            self._refuse(
                f"{self.own.host} runs bundle {short_digest(ours)} and {hello.host} runs bundle "
                f"{short_digest(theirs)}{part}: copy one of the two to both, and give a robot what is its "
                "own with --devices"
            )
        self._refuse(remedy)

    def _first_difference(self, hello: Hello) -> tuple[str, str]:
        """Which part of the mission the two do not have alike, and what is said of that; '' for none."""
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
        for what, ours, theirs, remedy in pairs:
            if ours != theirs:
                return what, (
                    f"{self.own.host} has {what} {ours.hex()[:12] or '(none)'} and {hello.host} has {what} "
                    f"{theirs.hex()[:12] or '(none)'}; start both from {remedy}, or from one bundle"
                )
        return "", ""

    def _check_devices(self, hello: Hello) -> None:
        """What moves only in a simulation must not wait for robots, nor robots for it."""
        worlds = {self.own.devices, hello.devices} - {""}
        if len(worlds) > 1:
            self._refuse(
                f"the devices of {self.own.host} are {self.own.devices} and those of {hello.host} are "
                f"{hello.devices}; start both with --sim, or none"
            )

    def _check_memory(self, hello: Hello) -> None:
        """Who keeps what it has must not hand it to somebody who forgets."""
        if "observer" in (self.own.role, hello.role) or bool(self.own.memory) == bool(hello.memory):
            return
        keeps, other = (self.own.host, hello.host) if self.own.memory else (hello.host, self.own.host)
        self._refuse(
            f"{keeps} keeps its coordinators in a journal and {other} does not; start both with "
            "--volatile, or none; under --sim both with --state, or none"
        )

    def _check_recovery(self, hello: Hello) -> None:
        """Two majorities of different members need not meet."""
        if "observer" not in (self.own.role, hello.role) and self.own.recovery != hello.recovery:
            ours, theirs = self.own.recovery or "nobody", hello.recovery or "nobody"
            self._refuse(
                f"{self.own.host} recovers coordinators by {ours} and {hello.host} by {theirs}; give both "
                "the same 'recovery' in their devices files"
            )

    def _check_origin(self, hello: Hello) -> None:
        """Whoever is sent to a place of another origin goes elsewhere."""
        if "observer" not in (self.own.role, hello.role) and self.own.origin != hello.origin:
            ours, theirs = (f"from {o}" if o else "from each home" for o in (self.own.origin, hello.origin))
            self._refuse(
                f"{self.own.host} counts places {ours} and {hello.host} {theirs}; give both the same "
                "'frame: {origin: ...}' in their devices files"
            )

    def _check_reservation(self, hello: Hello) -> None:
        """Who renews too seldom for others loses what it has."""
        if "observer" not in (self.own.role, hello.role) and self.own.reservation != hello.reservation:
            self._refuse(
                f"reservations of {self.own.host} last {self.own.reservation:g} s unheard and those of "
                f"{hello.host} {hello.reservation:g} s; give both the same 'reservations: {{lease: ...}}' in "
                "their devices files"
            )

    def _refuse(self, reason: str) -> NoReturn:
        self.refusal = Refuse(reason)
        raise GreetingError(f"greeting refused: {reason}")
