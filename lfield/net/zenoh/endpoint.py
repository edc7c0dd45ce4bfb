"""The streams of one process over its Zenoh session: keys of packets, opening, and peers that end.

| key | publications |
|---|---|
| `lfield/v1/at/NAME/PORT/CALLER/STREAM` | requests to open a stream, for the listener of a name |
| `lfield/v1/to/RECEIVER/SENDER/STREAM` | all other packets |

CALLER, RECEIVER and SENDER are inboxes, random numbers of processes; STREAM is a random number of the caller.
A process has one subscription for its inbox and one for each listener, so that a link needs no declaration of
a subscriber, which would be asynchronous. Tokens at `lfield/v1/at/NAME/PORT` and `lfield/v1/to/RECEIVER` end
with the process.

Any participant of the fabric may publish with these keys, so its effects on a process are limited: the number
of packets that wait for the event loop, of opened streams, and of answers to packets of unknown streams.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from lfield.net.transport import ZENOH
from lfield.net.zenoh.packets import HEADER_SIZE, Kind, Packet, decode_packet
from lfield.net.zenoh.pipe import ZenohPipe
from lfield.net.zenoh.send_window import MAX_SEGMENT
from lfield.net.zenoh.stream import NumberedStream

if TYPE_CHECKING:
    from lfield.net.zenoh.config import ZenohConfig
    from lfield.net.zenoh.session import ZenohSession

#: Prefix of all keys, with the version of the packets.
ROOT = "lfield/v1"
#: Bytes of the random numbers in keys.
ID_SIZE = 8

#: Bytes of the packets of one subscription that wait for the event loop, and the bytes that a waiting packet
#: counts in addition. Further packets are dropped, and their streams repeat them.
MAX_WAITING, WAITING_PACKET = 4 << 20, 1 << 10
#: Streams that callers may open, and packets of unknown streams that are answered, in any second. A
#: legitimate caller repeats its request.
MAX_OPENED, MAX_RESETS = 64, 64

#: Adopts a new pipe of a caller.
OnPipe = Callable[[ZenohPipe], None]


class _PerSecond:
    """Permits a number of events in each second."""

    def __init__(self, limit: int) -> None:
        self._limit, self._count, self._end = limit, 0, 0.0

    def is_permitted(self, now: float) -> bool:
        """Count an event; returns whether it is within the limit."""
        if now >= self._end:
            self._count, self._end = 0, now + 1.0
        self._count += 1
        return self._count <= self._limit


class _Inflow:
    """The packets of one subscription, from its thread to the event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, deliver: Callable[[str, bytes], None]) -> None:
        self._loop, self._deliver = loop, deliver
        #: The number of bytes that arrived, and of bytes that were delivered; each number is written by one
        #: thread only.
        self._arrived = self._delivered = 0

    def on_packet(self, key: str, data: bytes) -> None:
        """A packet arrived, in the thread of the subscription."""
        if len(data) > HEADER_SIZE + MAX_SEGMENT or self._arrived - self._delivered > MAX_WAITING:
            return
        self._arrived += len(data) + WAITING_PACKET
        with suppress(RuntimeError):
            # The loop may be closed.
            self._loop.call_soon_threadsafe(self._deliver_one, key, data)

    def _deliver_one(self, key: str, data: bytes) -> None:
        self._delivered += len(data) + WAITING_PACKET
        self._deliver(key, data)


class ZenohEndpoint:
    """All streams of a session, in the running loop.

    Raises ImportError without the package, and ValueError for a setting that Zenoh rejects.
    """

    def __init__(self, config: ZenohConfig) -> None:
        # The only import of the package, which may be missing.
        from lfield.net.zenoh.session import ZenohSession, rejected_setting

        if reason := rejected_setting(config):
            raise ValueError(reason)
        self._loop = asyncio.get_running_loop()
        self.is_open = asyncio.Event()
        #: The reason why the session is not open.
        self.failure = ""
        self._session: ZenohSession = ZenohSession(
            config, self._in_loop(self.is_open.set), self._in_loop(self._on_failure)
        )
        self._inbox = secrets.token_hex(ID_SIZE)
        #: Streams by inbox of the peer and number; the inbox is '' until a dialled peer has answered.
        self._pipes: dict[tuple[str, str], ZenohPipe] = {}
        self._listeners: dict[str, tuple[OnPipe, int, int]] = {}
        self._openings, self._resets = _PerSecond(MAX_OPENED), _PerSecond(MAX_RESETS)
        self._session.subscribe(
            f"{ROOT}/to/{self._inbox}/*/*", _Inflow(self._loop, self._on_packet).on_packet
        )
        self._session.declare_token(f"{ROOT}/to/{self._inbox}")
        self._session.watch_tokens(f"{ROOT}/to/*", self._in_loop(self._on_token_end))

    def close(self) -> None:
        """Close the session; streams end without a message to their peers."""
        self._session.close()

    def _in_loop(self, call: Callable[..., None]) -> Callable[..., None]:
        """Call `call` in the loop, from any thread; without effect after the loop was closed."""

        def later(*arguments: object) -> None:
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(call, *arguments)

        return later

    def _on_failure(self, reason: str) -> None:
        self.failure = reason

    # --- opening ------------------------------------------------------------------------------------------

    async def find(self, name: str, port: int) -> tuple[bool, int]:
        """Whether a program listens at a name, and how many routers and peers this process reaches."""
        result: asyncio.Future[tuple[bool, int]] = self._loop.create_future()

        def on_found(exists: bool, neighbours: int) -> None:
            if not result.done():
                result.set_result((exists, neighbours))

        self._session.find_token(f"{ROOT}/at/{name}/{port}", self._in_loop(on_found))
        return await result

    def has_listener(self, name: str, port: int) -> bool:
        """Whether this process itself listens at a name."""
        return f"{name}/{port}" in self._listeners

    def listen(self, name: str, port: int, on_pipe: OnPipe) -> None:
        """Accept streams at a name."""
        key = f"{ROOT}/at/{name}/{port}"
        requests = _Inflow(self._loop, self._on_open_request)
        subscription = self._session.subscribe(f"{key}/*/*", requests.on_packet)
        self._listeners[f"{name}/{port}"] = (on_pipe, subscription, self._session.declare_token(key))

    def stop_listening(self, name: str, port: int) -> None:
        """Accept no further streams; existing streams remain open."""
        if (listener := self._listeners.pop(f"{name}/{port}", None)) is not None:
            for handle in listener[1:]:
                self._session.withdraw(handle)

    def dial(self, name: str, port: int) -> ZenohPipe:
        """A stream to a listener; its `opened` is done when the listener has accepted it."""
        stream = secrets.token_hex(ID_SIZE)
        request = f"{ROOT}/at/{name}/{port}/{self._inbox}/{stream}"
        pipe = self._pipes["", stream] = ZenohPipe(
            NumberedStream(self._loop.time(), calls=True),
            (ZENOH + name, port),
            lambda data: self._session.publish_once(request, data),
            lambda: self._forget("", stream),
        )
        return pipe

    def _on_open_request(self, key: str, data: bytes) -> None:
        *_, name, port, sender, stream = key.split("/")
        listener, packet = self._listeners.get(f"{name}/{port}"), decode_packet(data)
        if listener is None or packet is None or packet.kind is not Kind.OPEN:
            return
        pipe = self._pipes.get((sender, stream))
        if pipe is None:
            if not self._openings.is_permitted(self._loop.time()):
                return
            pipe = self._accepted(sender, stream, (ZENOH + sender, int(port)))
            listener[0](pipe)
        pipe.on_packet(data)

    def _accepted(self, sender: str, stream: str, peer: tuple[str, int]) -> ZenohPipe:
        pipe = self._pipes[sender, stream] = ZenohPipe(
            NumberedStream(self._loop.time(), calls=False),
            peer,
            self._sender(sender, stream),
            lambda: self._forget(sender, stream),
        )
        return pipe

    # --- packets ------------------------------------------------------------------------------------------

    def _sender(self, receiver: str, stream: str) -> Callable[[bytes], None]:
        key = f"{ROOT}/to/{receiver}/{self._inbox}/{stream}"
        return lambda data: self._session.publish(key, data)

    def _on_packet(self, key: str, data: bytes) -> None:
        *_, sender, stream = key.split("/")
        pipe = self._pipes.get((sender, stream)) or self._pin(sender, stream)
        if pipe is not None:
            pipe.on_packet(data)
            return
        packet = decode_packet(data)
        is_answered = packet is not None and packet.kind is not Kind.RESET
        if is_answered and self._resets.is_permitted(self._loop.time()):
            answer = Packet(Kind.RESET, 0, 0, 0, b"").encode()
            self._session.publish_once(f"{ROOT}/to/{sender}/{self._inbox}/{stream}", answer)

    def _pin(self, sender: str, stream: str) -> ZenohPipe | None:
        """The listener of a dialled stream answers for the first time; from now on this listener is the only
        peer.
        """
        pipe = self._pipes.pop(("", stream), None)
        if pipe is not None:
            self._pipes[sender, stream] = pipe
            pipe.pin(self._sender(sender, stream), lambda: self._forget(sender, stream))
        return pipe

    def _forget(self, peer: str, stream: str) -> None:
        """A stream has ended."""
        if self._pipes.pop((peer, stream), None) is not None and peer:
            self._session.forget(f"{ROOT}/to/{peer}/{self._inbox}/{stream}")

    def _on_token_end(self, key: str) -> None:
        """A peer, or a router in between, has ended. Its last packets may still arrive, so ask the peer."""
        peer = key.rpartition("/")[2]
        for (inbox, _), pipe in list(self._pipes.items()):
            if inbox == peer:
                pipe.on_suspicion()
