"""What each message of somebody who is no host takes: the one table of who may have a host do what.

What only hosts say to one another is not in it: no right lets a person or a user of this computer say it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.authority.identity import Right, in_order
from lfield.wire.messages import Ping, Revocations
from lfield.wire.observing import EmergencyStop, Forget, Pause, Recover, StartRequest, StatusRequest
from lfield.wire.watching import Seen, Watch

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.authority.identity import Identity
    from lfield.authority.judge import Verdict
    from lfield.wire.messages import Message

#: The right that a message takes, and the one that takes it back. None: whoever is known at all may say it.
RIGHTS: Mapping[type[Message], tuple[Right | None, Right | None]] = {
    StatusRequest: (Right.OBSERVE, None),
    Watch: (Right.OBSERVE, None),
    Seen: (Right.OBSERVE, None),
    Ping: (None, None),
    Revocations: (None, None),
    EmergencyStop: (Right.STOP, Right.OPERATE),
    # To pause only makes safe, as a stop does.
    Pause: (Right.STOP, Right.OPERATE),
    Forget: (Right.OPERATE, None),
    Recover: (Right.OPERATE, None),
    StartRequest: (Right.OPERATE, None),
}
#: What a host may that looks at others, as when it is asked to begin anew: a stop is for everybody.
OF_HOSTS = frozenset({Right.OBSERVE, Right.STOP})


def lacks(who: Identity, verdict: Verdict, message: Message) -> str:
    """Why somebody who is no host here may not send a message, in a sentence; '' when they may."""
    rights = RIGHTS.get(type(message))
    if rights is None:
        return f"{who} sent a {type(message).__name__}, which only hosts say to one another"
    needed = rights[1] if getattr(message, "lift", False) else rights[0]
    may = verdict.left(who.may | OF_HOSTS if who.kind == "host" else who.may)
    if needed is None or needed in may:
        return ""
    if needed in verdict.barred:
        return verdict.barred[needed]
    if verdict.extent != "all" and needed in who.may:
        return f"{verdict.why}; until then {who} may only look and stop"
    has = in_order(may).replace(",", " and ") or "do nothing"
    return f"{who} may {has}, and this takes the right to {needed}: {_remedy(who, needed)}"


def _remedy(who: Identity, needed: Right) -> str:
    if who.kind == "local":
        return "the user who runs the host has it, and root"
    if who.kind == "host":
        return "a person has it, not a host"
    rights = in_order({*who.may, needed})
    return (
        f"new keys give it: 'lfield keys revoke person {who.name}', then "
        f"'lfield keys person {who.name} --may {rights}'"
    )
