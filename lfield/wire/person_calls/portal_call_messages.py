"""Portal calls of persons: request, cancellation, result. Messages as in `messages`.

The values are msgpack (`lfield.vm.person_calls.value_codec`); the host checks them against the types of the
portal.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from lfield.wire.fields import Count, Label, Name, OrderId, Text

#: The most bytes of the arguments of a call, and of its result.
MAX_ARGUMENTS, MAX_RESULT = 8 << 10, 256 << 10
#: The longest time limit of a call, in seconds.
MAX_LIMIT = 3600.0

#: The outcomes of a call: a `refused` call has not started; for `unknown` the host does not know whether it
#: has.
CallOutcome = Literal["returned", "thrown", "refused", "unknown"]


class PortalCallRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=76):
    """From an observer: call a portal of a resource of this host, at most once for each `id`.

    A repetition with the same id joins the call, or is answered with its result. `incarnation` is the
    incarnation of the host at the first attempt: another one means that the host has restarted, and may have
    executed the call. `limit` is in seconds. `is_assistant`: an AI assistant calls for the person. Answered
    by a `PortalCallResult`.
    """

    id: OrderId
    incarnation: Count
    resource: Name
    portal: Label
    arguments: Annotated[bytes, Meta(max_length=MAX_ARGUMENTS)]
    limit: Annotated[float, Meta(gt=0.0, le=MAX_LIMIT)]
    is_assistant: bool = False


class PortalCallCancel(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=77):
    """From an observer: cancel the call with this id, which ends with a CancelledException."""

    id: OrderId


class PortalCallResult(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=78):
    """The end of a call: `value` is its result. `kind` is the exception of L that it has thrown, or the code
    of the reason why the call was refused or its outcome is unknown (`RefusalCode`); `message` explains it.
    """

    id: OrderId
    outcome: CallOutcome
    kind: Label = ""
    message: Text = ""
    value: Annotated[bytes, Meta(max_length=MAX_RESULT)] = b""


#: The reason why a call was refused, or its outcome is unknown.
RefusalCode = Literal[
    "not-permitted",
    "paused",
    "stopping",
    "busy",
    "no-portal",
    "arguments",
    "cancelled",
    "restarted",
    "dropped",
]
