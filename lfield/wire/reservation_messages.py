"""Messages between hosts about reservations (decision 53; messages as in `messages`).

A coordinator reserves a resource by moving to its host, so there is no request message. These two messages
renew and release a reservation. They have no answer: the end of the lease compensates for a lost message.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.wire.fields import Count, Name, Ordinal


class RenewReservation(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=20):
    """A start of a coordinator is on the sender, in the block that reserves a resource of the receiver."""

    resource: Name
    number: Count
    agent: Name
    generation: Ordinal


class ReleaseReservation(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=21):
    """The coordinator with this reservation has left its block."""

    resource: Name
    number: Count


ReservationMessage = RenewReservation | ReleaseReservation
