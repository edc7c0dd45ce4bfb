"""The right that each message of an observer requires: the one table of permissions.

Messages between hosts are not in it: no right allows an observer to send them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.authority.identity import Right, sorted_rights
from lfield.wire.messages import Ping, RevocationUpdate
from lfield.wire.observer_messages import (
    BallotHold,
    EmergencyStop,
    ForgetRequest,
    InputLine,
    Pause,
    RecoverRequest,
    StartRequest,
)
from lfield.wire.person_calls.portal_call_messages import PortalCallCancel, PortalCallRequest
from lfield.wire.service_messages import (
    BundleOffer,
    BundlePiece,
    MissionCommand,
    Proposal,
    ServiceQuery,
    StageRequest,
    VoteQuery,
    VoteReport,
)
from lfield.wire.subscription_messages import EventAck, Subscribe

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.authority.identity import Identity
    from lfield.authority.peer_verification import AdmissionDecision
    from lfield.wire.messages import Message

#: The right that a message requires, and the right for its opposite. None: any authenticated peer may send
#: it.
RIGHTS: Mapping[type[Message], tuple[Right | None, Right | None]] = {
    Subscribe: (Right.OBSERVE, None),
    EventAck: (Right.OBSERVE, None),
    Ping: (None, None),
    RevocationUpdate: (None, None),
    EmergencyStop: (Right.STOP, Right.OPERATE),
    # A pause only makes devices safe, as a stop does.
    Pause: (Right.STOP, Right.OPERATE),
    # Only from the host's own service, over the control socket.
    BallotHold: (Right.COMMAND, Right.COMMAND),
    ForgetRequest: (Right.OPERATE, None),
    RecoverRequest: (Right.OPERATE, None),
    StartRequest: (Right.OPERATE, None),
    # Programs act on this input.
    InputLine: (Right.OPERATE, None),
    # The access file of the mission decides which portals.
    PortalCallRequest: (Right.OPERATE, None),
    PortalCallCancel: (Right.OPERATE, None),
    ServiceQuery: (Right.OBSERVE, None),
    BundleOffer: (Right.COMMAND, None),
    BundlePiece: (Right.COMMAND, None),
    StageRequest: (Right.COMMAND, None),
    Proposal: (Right.COMMAND, None),
    # Any host may request votes, and may make a ballot fail, which has no effect.
    VoteQuery: (Right.OBSERVE, None),
    VoteReport: (Right.COMMAND, None),
    MissionCommand: (Right.COMMAND, None),
}
#: The rights of a host that sends operator messages, as when its journal is reset: any member may stop.
HOST_RIGHTS = frozenset({Right.OBSERVE, Right.STOP})


def missing_permission(identity: Identity, verdict: AdmissionDecision, message: Message) -> str:
    """The reason why an observer may not send a message, in a sentence; '' if it may."""
    rights = RIGHTS.get(type(message))
    if rights is None:
        return f"{identity} sent a {type(message).__name__}, which only hosts may send"
    if isinstance(message, BallotHold) and identity.kind != "local":
        return f"{identity} may not hold this host for a vote: only the service of the robot does"
    needed = rights[1] if getattr(message, "lift", False) else rights[0]
    may = verdict.remaining_rights(identity.may | HOST_RIGHTS if identity.kind == "host" else identity.may)
    if needed is None or needed in may:
        return ""
    if needed in verdict.denied_rights:
        return verdict.denied_rights[needed]
    if verdict.extent != "all" and needed in identity.may:
        return f"{verdict.reason}; until then {identity} may only observe and stop"
    has = sorted_rights(may).replace(",", " and ") or "do nothing"
    return f"{identity} may {has}, and this takes the right to {needed}: {_remedy(identity, needed)}"


def _remedy(identity: Identity, needed: Right) -> str:
    if identity.kind == "local":
        return "the user who runs the host has it, and root"
    if identity.kind == "host":
        return "a person has it, not a host"
    rights = sorted_rights({*identity.may, needed})
    return (
        f"new keys give it: 'lfield keys revoke person {identity.name}', then "
        f"'lfield keys person {identity.name} --may {rights}'"
    )
