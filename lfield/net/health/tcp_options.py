"""The options of TCP connections for radio, and what the kernel tells of them (Linux, `linux/tcp.h`).

A link carries few small messages, each of which somebody waits for. TCP's defaults are for bulk transfer: its
retransmission time-out is at least 200 ms, doubles with each loss up to 120 s, and acknowledgements of a
receiver with nothing to say wait for 40 ms or more.
"""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from typing import Protocol

from lfield.net.health.traffic import Counts

#: The first six time-outs of a connection with few packets under way do not double (since Linux 2.6.34).
THIN_LINEAR_TIMEOUTS = 16
#: The longest retransmission time-out in ms, since Linux 6.15; the kernel takes no less than 1,000. After an
#: outage a connection continues within this time. (The kernel then ends one after 11 s without an
#: acknowledgement; a silent link is given up before that.)
RTO_MAX_MS, LONGEST_TIMEOUT_MS = 44, 1_000
#: The least retransmission time-out beyond the round trip, and the longest wait of an acknowledgement for a
#: message to travel with, in microseconds, since Linux 6.15.
RTO_MIN_US, DELACK_MAX_US = 45, 46
#: So many bytes that it has not sent the kernel may have before it takes no more: an order to stop waits
#: behind them.
NOTSENT_LOWAT, MOST_NOT_SENT = 25, 4096
LONGEST_ACK_DELAY_US = 5_000

#: The margin of the retransmission time-out over the round trip, in seconds: half a round trip, within these
#: bounds. A short margin repeats a lost packet early; one that is too short for the path repeats packets that
#: are only late, which a slow channel has no room for.
MARGIN, LEAST_MARGIN, MOST_MARGIN = 0.5, 0.02, 0.2
#: From this round trip in s on, time-outs double, and the longest is so many round trips. A longer round trip
#: is mostly a queue: where all connections of a slow channel repeat each second what still waits in it, the
#: repeats fill the channel for good (congestion collapse, RFC 896).
CONGESTED, LONGEST_TIMEOUT = 0.5, 4.0

#: The part of `struct tcp_info` up to `tcpi_dsack_dups`, and where its fields are.
_INFO_SIZE = 220
_TOTAL_RETRANS, _BYTES_RECEIVED, _DATA_SEGS_OUT, _BYTES_SENT, _DSACK_DUPS = 100, 128, 156, 200, 216


class Socket(Protocol):
    """What is needed of a socket; uvloop's are no `socket.socket`."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """The value of an option."""

    def setsockopt(self, level: int, option: int, value: int, /) -> None:
        """Set an option."""


def set_options(made: Socket) -> None:
    """Set what this kernel has; the others are left at what they are."""
    # A hop is one small write that nobody answers: it must not wait to be joined by more.
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for option, value in (
        (NOTSENT_LOWAT, MOST_NOT_SENT),
        (DELACK_MAX_US, LONGEST_ACK_DELAY_US),
    ):
        with suppress(OSError):
            made.setsockopt(socket.IPPROTO_TCP, option, value)
    set_time_outs(made, 0.0)


def margin(round_trip: float) -> float:
    """The margin for a round trip, in seconds."""
    return min(MOST_MARGIN, max(LEAST_MARGIN, MARGIN * round_trip))


def set_time_outs(made: Socket, round_trip: float) -> None:
    """Set the retransmission time-outs for a measured round trip in s, where this kernel has the options."""
    congested = round_trip >= CONGESTED
    longest = (
        max(LONGEST_TIMEOUT_MS, round(LONGEST_TIMEOUT * round_trip * 1e3))
        if congested
        else LONGEST_TIMEOUT_MS
    )
    for option, value in (
        (THIN_LINEAR_TIMEOUTS, int(not congested)),
        (RTO_MAX_MS, longest),
        (RTO_MIN_US, round(margin(round_trip) * 1e6)),
    ):
        with suppress(OSError):
            made.setsockopt(socket.IPPROTO_TCP, option, value)


def counts(made: Socket) -> Counts | None:
    """What the kernel has counted; None where it does not tell all of it (before Linux 4.19)."""
    try:
        info = made.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_SIZE)
    except OSError:
        return None
    if len(info) < _INFO_SIZE:
        return None
    (received,) = struct.unpack_from("=Q", info, _BYTES_RECEIVED)
    (sent,) = struct.unpack_from("=Q", info, _BYTES_SENT)
    repeated, needless = (struct.unpack_from("=I", info, at)[0] for at in (_TOTAL_RETRANS, _DSACK_DUPS))
    (segments,) = struct.unpack_from("=I", info, _DATA_SEGS_OUT)
    return Counts(sent, received, segments, max(0, repeated - needless))
