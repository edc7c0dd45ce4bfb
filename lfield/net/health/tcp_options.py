"""TCP options for radio links, and the kernel's TCP statistics (Linux, `linux/tcp.h`).

A link carries few small, urgent messages. TCP's defaults suit bulk transfer: a retransmission time-out of at
least 200 ms that doubles with each loss up to 120 s, and acknowledgements delayed by 40 ms or more.
"""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from typing import Protocol

from lfield.net.health.traffic import Delivery, TcpCounts

#: The first six time-outs of a connection with few packets in flight do not double (since Linux 2.6.34).
THIN_LINEAR_TIMEOUTS = 16
#: Maximum retransmission time-out in ms, since Linux 6.15; the kernel's minimum is 1,000. After an outage a
#: connection continues within this time. (The kernel then ends a connection after 11 s without an
#: acknowledgement; a silent link is closed before that.)
RTO_MAX_MS, LONGEST_TIMEOUT_MS = 44, 1_000
#: Minimum retransmission time-out beyond the round trip, and maximum delay of an acknowledgement, in
#: microseconds, since Linux 6.15.
RTO_MIN_US, DELACK_MAX_US = 45, 46
#: Maximum unsent bytes in the kernel: a stop order waits behind them.
NOTSENT_LOWAT, MAX_NOT_SENT = 25, 4096
LONGEST_ACK_DELAY_US = 5_000

#: Margin of the retransmission time-out over the round trip, in seconds: half a round trip, within these
#: bounds. A short margin repeats a lost packet early; a margin that is too short for the path repeats packets
#: that are only late, which wastes a slow channel.
MARGIN, MIN_MARGIN, MAX_MARGIN = 0.5, 0.02, 0.2
#: From this round trip in s on, time-outs double, and the maximum is this many round trips. A longer round
#: trip is mostly queueing: if all connections of a slow channel repeated queued data each second, the channel
#: would stay full (congestion collapse, RFC 896).
CONGESTED, LONGEST_TIMEOUT = 0.5, 4.0

#: `struct tcp_info` up to `tcpi_dsack_dups`, and the offsets of its fields.
_INFO_SIZE = 220
_TOTAL_RETRANS, _BYTES_RECEIVED, _DATA_SEGS_OUT, _BYTES_SENT, _DSACK_DUPS = 100, 128, 156, 200, 216
#: `struct tcp_info` up to `tcpi_snd_wnd` (since Linux 5.4).
_DELIVERY_SIZE = 232
_UNACKED, _RTT, _BYTES_ACKED, _NOTSENT_BYTES, _SND_WND = 24, 68, 120, 144, 228


class TcpSocket(Protocol):
    """The socket methods used here; uvloop's sockets are no `socket.socket`."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """The value of an option."""

    def setsockopt(self, level: int, option: int, value: int, /) -> None:
        """Set an option."""


def set_options(connection: TcpSocket) -> None:
    """Set the options that this kernel has."""
    # A hop is one small unanswered write, which must not be delayed for coalescing (Nagle).
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for option, value in (
        (NOTSENT_LOWAT, MAX_NOT_SENT),
        (DELACK_MAX_US, LONGEST_ACK_DELAY_US),
    ):
        with suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
    set_time_outs(connection, 0.0)


def set_listening_options(connection: TcpSocket) -> None:
    """Answer a caller only twice, at once and after a second: the caller dials again.

    The kernel's five repetitions would fill a path that has become so slow that callers have given up.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_SYNCNT, 1)


def margin(round_trip: float) -> float:
    """The margin for a round trip, in seconds."""
    return min(MAX_MARGIN, max(MIN_MARGIN, MARGIN * round_trip))


def set_time_outs(connection: TcpSocket, round_trip: float) -> None:
    """Set the retransmission time-outs for a measured round trip in s, if this kernel has the options."""
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
            connection.setsockopt(socket.IPPROTO_TCP, option, value)


def delay_acknowledgements(connection: TcpSocket) -> None:
    """Send the next acknowledgement with the answer; after a pause the kernel would send it alone."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 0)


def read_counts(connection: TcpSocket) -> TcpCounts | None:
    """The kernel's counters; None if they are incomplete (before Linux 4.19)."""
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_SIZE)
    except OSError:
        return None
    if len(info) < _INFO_SIZE:
        return None
    (received,) = struct.unpack_from("=Q", info, _BYTES_RECEIVED)
    (sent,) = struct.unpack_from("=Q", info, _BYTES_SENT)
    repeated, needless = (struct.unpack_from("=I", info, at)[0] for at in (_TOTAL_RETRANS, _DSACK_DUPS))
    (segments,) = struct.unpack_from("=I", info, _DATA_SEGS_OUT)
    return TcpCounts(sent, received, segments, max(0, repeated - needless))


def read_delivery(connection: TcpSocket) -> Delivery | None:
    """The data that the kernel has delivered; None if the counters are incomplete (before Linux 5.4).

    Data is pending while it is in flight, or unsent although the peer has a window for it: without a route
    the kernel sends no data.
    """
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _DELIVERY_SIZE)
    except OSError:
        return None
    if len(info) < _DELIVERY_SIZE:
        return None
    unacked, unsent, window = (
        struct.unpack_from("=I", info, at)[0] for at in (_UNACKED, _NOTSENT_BYTES, _SND_WND)
    )
    round_trip, variation = struct.unpack_from("=II", info, _RTT)
    (acked,) = struct.unpack_from("=Q", info, _BYTES_ACKED)
    is_pending = unacked > 0 or (unsent > 0 and window > 0)
    return Delivery(acked, is_pending, round_trip * 1e-6, variation * 1e-6)
