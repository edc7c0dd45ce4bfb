"""What hosts say to one another about reservations (decision 53; messages as in `messages`).

To reserve something its coordinator goes to its host, so nobody asks by a message. These two say how long it
is needed. Neither is answered: what is lost ends with its lease.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.wire.fields import Count, Name, Ordinal


class Renew(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=20):
    """That start of a coordinator is on the sender, in the block that reserves a resource of the receiver."""

    resource: Name
    number: Count
    agent: Name
    generation: Ordinal


class Release(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=21):
    """The coordinator that has this reservation has left its block."""

    resource: Name
    number: Count


ReservationMessage = Renew | Release
