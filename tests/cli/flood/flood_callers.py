"""A member with valid keys that sends continuously: `python flood_callers.py PORT KEYS HOST KIND`. Prints
`linked` when the host at that port of this computer has accepted it, `refused` after a rejection, and
`closed` when the link ends, with the time. The member reconnects immediately until it is stopped.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from msgspec.structs import replace

from lfield.authority import keystore
from lfield.net.tls import TlsIdentity
from lfield.wire.codec import decode, encode, encode_transfer, frame_decoder, limits
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.messages import (
    Backpressure,
    GossipUpdate,
    HandshakeRefused,
    Hello,
    LivenessCounter,
    Message,
    Ping,
)

#: Frames of each kind, sent repeatedly.
BLOCK, OVER = bytes(256 << 10), bytes(4 << 20)
KINDS = {
    "pings": encode(Ping(1)) * 600,
    "records": encode(Ping(1)) * 600,
    "gossip": encode(GossipUpdate([], [LivenessCounter(0, 7, 9)])) * 300,
    "rooms": encode(Backpressure("")) * 300,
    "transfers": encode_transfer(Transfer("tom", 1, 1, 1, b"p" * 32, 7, len(BLOCK)), BLOCK) + BLOCK,
    # Of several coordinators in turn, and blocks over the limit.
    "turns": b"".join(
        encode_transfer(Transfer(agent, 1, 1, 1, b"p" * 32, 7, len(BLOCK)), BLOCK) + BLOCK
        for agent in ("tom", "ann", "eve")
    ),
    "oversize": encode_transfer(Transfer("tom", 1, 1, 1, b"p" * 32, 7, len(OVER)), OVER) + OVER,
}


class Caller:
    """One link to the host at a port."""

    def __init__(self, port: int, keys: TlsIdentity, hello: Hello) -> None:
        self.link = socket.create_connection(("127.0.0.1", port), 10.0)
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._channel, self._decoder = keys.channel(calls=True), frame_decoder(lambda *_: None)
        self._decoder.limits = limits("host", 1 << 20)
        self.link.sendall(self._channel.data_to_send())
        while not self._channel.proven:
            list(self._channel.receive(self._read()))
            self.link.sendall(self._channel.data_to_send())
        self.send(encode(hello))
        self._messages = self._received()

    def send(self, data: bytes, record: int = 1 << 14) -> None:
        """Send bytes in records of a given size."""
        parts = (data[at : at + record] for at in range(0, len(data), record))
        self.link.sendall(b"".join(map(self._channel.encrypt, parts)))

    def receive(self) -> Message:
        """The next message. Raises ConnectionError when the link has ended."""
        return next(self._messages)

    def _received(self) -> Iterator[Message]:
        while True:
            for plain in self._channel.receive(self._read()):
                for kind, payload in self._decoder.feed(plain):
                    yield decode(kind, payload)

    def _read(self) -> bytes:
        data = self.link.recv(1 << 16)
        if not data:
            raise ConnectionResetError
        return data


def linked(port: int, keys: TlsIdentity, hello: Hello) -> Caller:
    """Open a link and complete the handshake. Raises ConnectionError."""
    caller = Caller(port, keys, hello)
    caller.receive()
    message = caller.receive()
    if isinstance(message, HandshakeRefused):
        print(f"refused {time.monotonic():.3f} {message.reason}", flush=True)
        raise ConnectionResetError
    return caller


def greeting(port: int, keys: TlsIdentity, name: str) -> Hello:
    """The Hello of another host of the same mission: that of the host at `port`, with the name `name`."""
    hello = Caller(port, keys, Hello("observer", "observer", 0)).receive()
    memory = 77 if hello.journal_id else 0
    return replace(hello, host=name, incarnation=4711, coordinators=[], journal_id=memory)


def main() -> None:
    """Connect and send until stopped."""
    port, name, kind = int(sys.argv[1]), sys.argv[3], sys.argv[4]
    keys = TlsIdentity(keystore.read_keys(Path(sys.argv[2]), "host"))
    hello = greeting(port, keys, name)
    while True:
        try:
            caller = linked(port, keys, hello)
            print(f"linked {time.monotonic():.3f}", flush=True)
            if kind == "handshakes":
                caller.link.close()
                continue
            flood(caller, KINDS[kind], len(encode(Ping(1))) if kind == "records" else 1 << 14)
        except OSError:
            print(f"closed {time.monotonic():.3f}", flush=True)
            time.sleep(0.05)


def flood(caller: Caller, data: bytes, record: int) -> None:
    """Send until the link ends, in records of a given size. Answers are discarded."""
    threading.Thread(target=throw_away, args=[caller.link], daemon=True).start()
    caller.link.settimeout(None)
    while True:
        caller.send(data, record)


def throw_away(link: socket.socket) -> None:
    with suppress(OSError):
        while link.recv(1 << 20):
            pass


if __name__ == "__main__":
    main()
