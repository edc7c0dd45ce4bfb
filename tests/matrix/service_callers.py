"""Peers of the matrix that send requests to the service of a robot, and a service that records them."""

from __future__ import annotations

import asyncio
import random

from link_attacker import Attacker, context, send_messages
from network_callers import BLOCK, HOP, NOW, SAID_BY_COMMANDS, SAID_BY_HOSTS, Caller, Network

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.certificate_reader import revoked_in
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.service.server import ServiceServer
from lfield.text.log_messages import LogLine
from lfield.wire.codec import encode, encode_transfer
from lfield.wire.messages import Hello, Message, Ping, RevocationUpdate
from lfield.wire.service_messages import (
    Ballot,
    BallotState,
    BundleOffer,
    BundlePiece,
    MissionCommand,
    Proposal,
    ServiceMessage,
    ServiceQuery,
    StageRequest,
    VoteQuery,
    VoteReport,
)

ID, DIGEST = bytes(16), bytes(32)
#: Requests by column.
REQUESTS: dict[str, ServiceMessage] = {
    "status": ServiceQuery(),
    "offer": BundleOffer(DIGEST, DIGEST, 1, 1, 0, [(ID, 1)]),
    "piece": BundlePiece(DIGEST, 0, False, b"p"),
    "stage": StageRequest(DIGEST, DIGEST),
    "propose": Proposal(Ballot(ID, DIGEST, ["alpha"], "anna")),
    "query": VoteQuery(ID, closes=True),
    "report": VoteReport(ID, {"bravo": "yes"}),
    "start": MissionCommand("start"),
    "stop": MissionCommand("stop", discards=True),
}


class RecordingService:
    """Records and answers every request."""

    def __init__(self) -> None:
        self.done: list[ServiceMessage] = []

    async def answer(self, message: ServiceMessage, operator: str, person: str = "") -> ServiceMessage:
        self.done.append(message)
        return BallotState(ID, None, {}, {}, "open")

    def note(self, line: LogLine) -> None:
        pass


class Services:
    """The service of host alpha, and the callers of a network."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def tried(self, who: str, what: str) -> bool:
        """Whether the service accepted the request, from a host or an observer."""
        caller = self._network.callers[who]
        return any(asyncio.run(self._try(caller.hello(role), caller, what)) for role in ("host", "observer"))

    async def _try(self, hello: Hello, caller: Caller, what: str) -> bool:
        network, clock, recorded = self._network, ManualClock(NOW), RecordingService()
        tls, revoked = (
            TlsIdentity(network.alpha),
            revoked_in(network.list, network.team.authority.certificate),
        )
        admission = CertificateAdmission(
            network.alpha, tls.own_identity(), TrustedClock(clock), revoked, network.list
        )
        transport = TcpTransport(1 << 16, tls)
        server = ServiceServer("alpha", recorded, transport, clock, random.Random(1), admission)
        address = await server.listen("127.0.0.1:0")
        try:
            attacker = Attacker(context(caller.keys) if caller.tls else None, caller.bent)
            await send_messages(
                attacker, address, [encode(hello), *self._words(what), encode(Ping(77))], None
            )
            if what == "hear":
                return any(isinstance(message, Hello) for message in attacker.received)
            if what in ("list", "forged"):
                return admission.number == (2 if what == "list" else 9)
            return bool(recorded.done)
        finally:
            server.close()

    def _words(self, what: str) -> list[bytes]:
        if what == "hear":
            return []
        if what == "hop":
            return [encode_transfer(HOP, BLOCK) + BLOCK]
        if what in ("list", "forged"):
            return [encode(RevocationUpdate(self._network.newer if what == "list" else self._network.forged))]
        every: dict[str, Message] = {**SAID_BY_HOSTS, **SAID_BY_COMMANDS, **REQUESTS}
        return [encode(every[what])]
