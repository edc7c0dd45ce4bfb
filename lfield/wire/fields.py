"""What the fields of messages may hold: bounds, and texts and spans of time cut to them."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

#: Longest name of an agent or host, in characters.
MAX_NAME = 128

#: Longest sentence or traceback that travels, in characters; `clip` cuts to it.
MAX_TEXT = 2048

#: Longest text of a fact or of a reason in a report, in characters: reports are many.
MAX_LABEL = 256

#: The most members of a set that is a fact.
MAX_MEMBERS = 64

#: Bytes of a program or deployment hash.
HASH_SIZE = 32

#: The most an age or another span of time may be, in seconds; `age` cuts to it.
OLDEST = 1e9

#: The most numbers of an array of telemetry that a status shows.
MAX_NUMBERS = 1024

#: The longest revocation list, in bytes.
MAX_LIST = 64 << 10

Name = Annotated[str, Meta(min_length=1, max_length=MAX_NAME)]
MaybeName = Annotated[str, Meta(max_length=MAX_NAME)]
Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
#: A number that whoever hears it counts on from: what comes next is still a Count.
Ordinal = Annotated[int, Meta(ge=0, le=2**62)]
Hash = Annotated[bytes, Meta(max_length=HASH_SIZE)]
#: The id of an order to stop or pause, or to end either: random, drawn by whoever gives it.
OrderId = Annotated[bytes, Meta(min_length=16, max_length=16)]
Index = Annotated[int, Meta(ge=0, le=2**16 - 1)]
Label = Annotated[str, Meta(max_length=MAX_LABEL)]
Age = Annotated[float, Meta(ge=0.0, le=OLDEST)]
#: A part of a whole.
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
#: A time in seconds since 1970 UTC, up to the year 9999.
Moment = Annotated[float, Meta(ge=0.0, le=2.6e11)]
#: The value of an attribute: a number, a truth, a text, or the members of a set.
FactValue = bool | int | float | Label | Annotated[list[Label], Meta(max_length=MAX_MEMBERS)]
#: Where a value is from that a host tells of its agents.
ToldBy = Literal["stated", "told", "measured"]
Telemetry = bool | int | float | Text | Annotated[list[int | float], Meta(max_length=MAX_NUMBERS)]


#: So many hexadecimal digits of a bundle's digest are shown, everywhere the same: people compare them.
DIGITS = 16


def short_digest(digest: bytes) -> str:
    """The digest of a bundle as every command and log line shows it; '' for none."""
    return digest.hex()[:DIGITS]


def clip(text: str, longest: int = MAX_TEXT) -> str:
    """The text cut to what a message may carry."""
    return text if len(text) <= longest else text[: longest - 4] + " ..."


def age(seconds: float) -> float:
    """A span of time as a message may carry it."""
    return min(max(0.0, seconds), OLDEST)
