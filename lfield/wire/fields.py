"""Bounds of the fields of messages, and functions that shorten texts and durations to them."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from lfield.hybrid_clock import MAX_TIMESTAMP

#: Longest name of an agent or host, in characters.
MAX_NAME = 128

#: Longest sentence or traceback in a message, in characters; `truncate` shortens to this length.
MAX_TEXT = 2048

#: Longest line of the operator's input, in characters.
MAX_INPUT = 1024

#: Longest text of an attribute value or of a reason in a report, in characters: reports are frequent.
MAX_LABEL = 256

#: The most members of a set in an attribute value.
MAX_MEMBERS = 64

#: Bytes of a program or deployment hash.
HASH_SIZE = 32

#: The maximum of an age or another duration, in seconds; `bounded_duration` limits to this value.
MAX_DURATION = 1e9

#: The most numbers of a telemetry array in a status.
MAX_NUMBERS = 1024

#: The longest revocation list, in bytes.
MAX_LIST = 64 << 10

#: The largest count: it fits the signed 64 bits of other languages.
MAX_COUNT = 2**63 - 1

Name = Annotated[str, Meta(min_length=1, max_length=MAX_NAME)]
OptionalName = Annotated[str, Meta(max_length=MAX_NAME)]
Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Count = Annotated[int, Meta(ge=0, le=MAX_COUNT)]
#: A hybrid timestamp of an event or a message (`lfield.hybrid_clock`), 0 for none.
Timestamp = Annotated[int, Meta(ge=0, le=MAX_TIMESTAMP)]
#: The difference of two times in milliseconds.
Milliseconds = Annotated[int, Meta(ge=-(2**49), le=2**49)]
#: A number that the receiver increments: its successor must still be a Count.
Ordinal = Annotated[int, Meta(ge=0, le=2**62)]
Hash = Annotated[bytes, Meta(max_length=HASH_SIZE)]
#: The id of an order to stop, to pause or to end either: random, chosen by the sender.
OrderId = Annotated[bytes, Meta(min_length=16, max_length=16)]
OptionalOrderId = Annotated[bytes, Meta(max_length=16)]
Index = Annotated[int, Meta(ge=0, le=2**16 - 1)]
Label = Annotated[str, Meta(max_length=MAX_LABEL)]
Duration = Annotated[float, Meta(ge=0.0, le=MAX_DURATION)]
#: A part of a whole.
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
#: A time in seconds since 1970 UTC, up to the year 9999.
Moment = Annotated[float, Meta(ge=0.0, le=2.6e11)]
#: The value of an attribute: a number, a truth, a text, or the members of a set.
FactValue = bool | int | float | Label | Annotated[list[Label], Meta(max_length=MAX_MEMBERS)]
#: The source of an attribute value.
ValueSource = Literal["stated", "told", "measured"]
Telemetry = bool | int | float | Text | Annotated[list[int | float], Meta(max_length=MAX_NUMBERS)]


#: The number of hexadecimal digits shown of a bundle's digest, the same everywhere, so that users can compare
#: digests.
DIGITS = 16


def short_digest(digest: bytes) -> str:
    """The digest of a bundle in the form of every command and log line; '' for none."""
    return digest.hex()[:DIGITS]


def truncate(text: str, longest: int = MAX_TEXT) -> str:
    """The text, shortened to the limit of a message."""
    return text if len(text) <= longest else text[: longest - 4] + " ..."


def bounded_duration(seconds: float) -> float:
    """A duration, limited to the maximum in a message."""
    return min(max(0.0, seconds), MAX_DURATION)
