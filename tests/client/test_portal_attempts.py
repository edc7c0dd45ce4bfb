"""The attempts of a portal call, and the answer of the host to each attempt."""

from __future__ import annotations

import asyncio

import pytest

from lfield.client import portal_call
from lfield.client.portal_call import PortalCaller
from lfield.client.team_connection import TeamConnection
from lfield.errors import AddressError, CallOutcomeUnknown, HandshakeError, PortalCallError, PortalCallRefused
from lfield.net.tcp_transport import TcpTransport
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.targets import TargetTeam
from lfield.wire.messages import TOO_MANY_OBSERVERS

REVOKED = HandshakeError("alpha refused: the keys of anna are revoked")
FULL = HandshakeError(f"alpha refused: {TOO_MANY_OBSERVERS}")
CUT = AddressError("alpha", "it closed the link without an answer")


@pytest.mark.parametrize(
    ("answers", "kind"),
    [
        ([REVOKED], PortalCallRefused),
        ([FULL, FULL, REVOKED], PortalCallRefused),
        ([CUT, REVOKED], CallOutcomeUnknown),
        ([FULL, CUT, FULL, REVOKED], CallOutcomeUnknown),
    ],
)
def test_a_refusal_after_a_possibly_started_attempt_leaves_the_outcome_unknown(
    monkeypatch, answers: list[Exception], kind: type[PortalCallError]
) -> None:
    remaining = iter(answers)

    async def send(*_: object) -> None:
        raise next(remaining)

    async def call() -> None:
        connection = TeamConnection(
            TcpTransport(1 << 20), HostLocator(TargetTeam((), {"alpha": "10.0.0.5:8181"}), list)
        )
        caller = PortalCaller(connection, lambda work: work.close())
        caller._places["arm1"] = portal_call.AgentPlace("alpha", 1)
        await caller.call("arm1", "grab", (), 1.0)

    monkeypatch.setattr(portal_call, "send_request", send)
    monkeypatch.setattr(portal_call, "RETRY_DELAY", 0.0)
    with pytest.raises(kind) as found:
        asyncio.run(call())
    assert found.value.kind == "not-permitted"
