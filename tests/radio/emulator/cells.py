"""Parameters of a poor radio link and of a shared channel, and the cells that are measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field


@dataclass(frozen=True, slots=True)
class Link:
    """One direction of a pair of robots.

    `delay` is the one-way delay; `jitter` is the width of a uniform addition to the delay (both in s).
    Packets stay in order. `loss` is the probability that a packet is lost. `fade` is the share of time in
    which a pair loses all packets of both directions; `burst` is the mean duration of a fade in s
    (exponential: Gilbert-Elliott model).
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    fade: float = 0.0
    burst: float = 0.25


@dataclass(frozen=True, slots=True)
class Channel:
    """A half-duplex channel that all robots share: one robot sends at a time, in turns.

    `rate` is in bit/s, 0 for no limit. `queue` is the size of the queue of each sender in bytes; a packet
    is lost if it does not fit.
    """

    rate: float = 0.0
    queue: int = 16384


@dataclass(frozen=True, slots=True)
class Cell:
    """A radio: the link of every direction, and the channel under all of them."""

    link: Link = field(default_factory=Link)
    channel: Channel = field(default_factory=Channel)

    def as_json(self) -> dict[str, object]:
        """The fields of the radio, as sent to the router."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Mapping[str, float]]) -> Cell:
        """The inverse of `as_json`."""
        return cls(Link(**data["link"]), Channel(data["channel"]["rate"], int(data["channel"]["queue"])))


#: A name has the round-trip delay, and the loss of each direction.
CELLS = {
    "perfect": Cell(),
    "50 ms": Cell(Link(delay=0.025, jitter=0.002)),
    "200 ms + 5 %": Cell(Link(delay=0.1, jitter=0.02, loss=0.05)),
    "100 ms + bursts": Cell(Link(delay=0.05, jitter=0.005, fade=0.10, burst=0.25)),
    "57.6 kbit/s + 100 ms + 5 %": Cell(Link(delay=0.05, jitter=0.005, loss=0.05), Channel(rate=57600)),
    "20 %": Cell(Link(delay=0.01, jitter=0.002, loss=0.20)),
    "500 ms + 2 %": Cell(Link(delay=0.25, jitter=0.05, loss=0.02)),
}
