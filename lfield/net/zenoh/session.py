"""Zenoh session in a thread of its own: the event loop never waits for a call of Zenoh.

One `put` may block for seconds when a subscriber is stopped. So all calls are made by this thread, from a
queue. Packets beyond `MAX_QUEUED` bytes are dropped, as by a full router: the numbered stream repeats them.
"""

from __future__ import annotations

import atexit
import itertools
import re
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import zenoh

from lfield.net.zenoh.config import ZenohConfig

#: Bytes of packets that wait for the thread; further packets are dropped.
MAX_QUEUED = 4 << 20
#: Seconds between two attempts to open the session, for a query of tokens, and for the packets that are
#: queued when the session is closed.
RETRY, QUERY_TIMEOUT, FLUSH_TIMEOUT = 0.5, 2.0, 3.0
#: Seconds for the threads of handlers at the end of the process: until the last callback, and after it.
HANDLER_TIMEOUT, HANDLER_PAUSE = 2.0, 0.05

#: Called in a thread of Zenoh, with the key and the bytes of a publication.
OnPacket = Callable[[str, bytes], None]
#: Called in a thread of Zenoh with whether a token was found, and the number of connected routers and peers.
OnFound = Callable[[bool, int], None]


class ZenohSession:
    """A session that is opened in the background, and again until it succeeds.

    Methods may be called in any thread and return at once. `on_open` and `on_failure` are called in the
    thread of the session: when it is open, and for each failed attempt.
    """

    def __init__(
        self, config: ZenohConfig, on_open: Callable[[], None], on_failure: Callable[[str], None]
    ) -> None:
        self._config, self._on_open, self._on_failure = config, on_open, on_failure
        self._calls: SimpleQueue[Callable[[], None] | tuple[str, bytes]] = SimpleQueue()
        #: The bytes of packets that were queued, and of packets that were sent; each number is written by one
        #: thread only.
        self._queued = self._sent = 0
        self.is_open = False
        self._is_closed = threading.Event()
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._declared: dict[int, Any] = {}
        self._handles = itertools.count()
        self._thread = threading.Thread(target=self._run, name="lfield-zenoh", daemon=True)
        self._thread.start()
        atexit.register(self._close_at_exit)

    # --- any thread ---------------------------------------------------------------------------------------

    def publish(self, key: str, data: bytes) -> None:
        """Publish a packet, or drop it without a session or while too many packets wait."""
        if self.is_open and self._queued - self._sent <= MAX_QUEUED:
            self._queued += len(data)
            self._calls.put((key, data))

    def publish_once(self, key: str, data: bytes) -> None:
        """Publish a packet with a key that is not used again."""
        if self.is_open:
            self._calls.put(lambda: self._put_once(key, data))

    def forget(self, key: str) -> None:
        """Forget a key, with which no more packets will be published."""
        self._calls.put(lambda: self._forget(key))

    def subscribe(self, key: str, on_packet: OnPacket) -> int:
        """Call `on_packet` for publications from now on. Returns a handle for `withdraw`."""

        def received(sample: zenoh.Sample) -> None:
            on_packet(str(sample.key_expr), sample.payload.to_bytes())

        return self._declare(lambda session: session.declare_subscriber(key, _handler(received)))

    def declare_token(self, key: str) -> int:
        """Declare a liveliness token, which ends with this process. Returns a handle for `withdraw`."""
        return self._declare(lambda session: session.liveliness().declare_token(key))

    def watch_tokens(self, key: str, on_end: Callable[[str], None]) -> int:
        """Call `on_end` in a thread of Zenoh when a token ends. Returns a handle for `withdraw`."""

        def changed(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                on_end(str(sample.key_expr))

        return self._declare(lambda session: session.liveliness().declare_subscriber(key, _handler(changed)))

    def find_token(self, key: str, on_found: OnFound) -> None:
        """Ask whether a token exists."""
        self._calls.put(lambda: self._find_token(key, on_found))

    def withdraw(self, handle: int) -> None:
        """End a subscription, token or watch."""
        self._calls.put(lambda: self._withdraw(handle))

    def close(self) -> None:
        """Send the queued packets, and close the session."""
        if not self._is_closed.is_set():
            self._is_closed.set()
            self._calls.put(self._end)

    def _close_at_exit(self) -> None:
        """Close the session at exit: the interpreter must not end while the thread is in a call of Zenoh."""
        self.close()
        self._thread.join(FLUSH_TIMEOUT)

    # --- the thread of the session ------------------------------------------------------------------------

    def _run(self) -> None:
        self._open()
        self._work()
        atexit.unregister(self._close_at_exit)

    def _work(self) -> None:
        while (session := self._session) is not None:
            call = self._calls.get()
            try:
                if isinstance(call, tuple):
                    self._put(session, *call)
                else:
                    call()
            except zenoh.ZError as error:
                self._on_failure(_first_line(error))

    def _open(self) -> None:
        while not self._is_closed.is_set():
            try:
                self._session = zenoh.open(_zenoh_config(self._config))
                self.is_open = True
                self._on_open()
                return
            except zenoh.ZError as error:
                self._on_failure(_first_line(error))
                self._is_closed.wait(RETRY)

    def _put(self, session: zenoh.Session, key: str, data: bytes) -> None:
        self._sent += len(data)
        publisher = self._publishers.get(key)
        if publisher is None:
            # A full queue drops packets. "Block" would stop the packets to all other hosts as well.
            publisher = self._publishers[key] = session.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                reliability=zenoh.Reliability.RELIABLE,
                express=True,
            )
        publisher.put(data)

    def _put_once(self, key: str, data: bytes) -> None:
        assert self._session is not None
        self._session.put(key, data, congestion_control=zenoh.CongestionControl.DROP, express=True)

    def _forget(self, key: str) -> None:
        if (publisher := self._publishers.pop(key, None)) is not None:
            publisher.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stub has no types here

    def _declare(self, make: Callable[[zenoh.Session], Any]) -> int:
        handle = next(self._handles)

        def declare() -> None:
            assert self._session is not None
            self._declared[handle] = make(self._session)

        self._calls.put(declare)
        return handle

    def _withdraw(self, handle: int) -> None:
        if (declared := self._declared.pop(handle, None)) is not None:
            declared.undeclare()

    def _find_token(self, key: str, on_found: OnFound) -> None:
        assert self._session is not None
        info, answers = self._session.info, list[bool]()
        neighbours = len(info.routers_zid()) + len(info.peers_zid())
        self._session.liveliness().get(
            key,
            _handler(
                lambda reply: answers.append(reply.ok is not None), lambda: on_found(any(answers), neighbours)
            ),
            timeout=QUERY_TIMEOUT,
        )

    def _end(self) -> None:
        self.is_open = False
        session, self._session = self._session, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]  # zenoh's stub has no types here


class _Handlers:
    """Counts the handlers of this process: each has a thread of Zenoh, which ends some time after its use."""

    def __init__(self) -> None:
        self._changed, self._count, self._is_used = threading.Condition(), 0, False

    def on_made(self) -> None:
        """A handler was made."""
        with self._changed:
            self._count, self._is_used = self._count + 1, True

    def on_dropped(self) -> None:
        """Zenoh does not call a handler any more."""
        with self._changed:
            self._count -= 1
            self._changed.notify_all()

    def wait_at_exit(self) -> None:
        """Wait for the threads of handlers: a callback at the end of the interpreter aborts the process."""
        if not self._is_used:
            return
        with self._changed:
            self._changed.wait_for(lambda: self._count <= 0, HANDLER_TIMEOUT)
        time.sleep(HANDLER_PAUSE)


_HANDLERS = _Handlers()
# This function is registered before the sessions, so it is called after they have closed.
atexit.register(_HANDLERS.wait_at_exit)


def _handler(call: Callable[[Any], None], drop: Callable[[], None] | None = None) -> Any:
    """A handler in a thread of its own.

    In the thread of the network, a handler would wait for the interpreter's lock while it holds a lock of
    Zenoh. A call of Zenoh that holds the interpreter's lock and needs the other lock would then stop the
    process for ever.
    """

    def dropped() -> None:
        if drop is not None:
            drop()
        _HANDLERS.on_dropped()

    _HANDLERS.on_made()
    return zenoh.handlers.Callback(call, dropped, indirect=True)


def _zenoh_config(config: ZenohConfig) -> zenoh.Config:
    settings = zenoh.Config()
    for key, value in config.options().items():
        settings.insert_json5(key, value)
    return settings


def rejected_setting(config: ZenohConfig) -> str:
    """The first setting that Zenoh rejects, with the reason; '' if Zenoh accepts all."""
    settings = zenoh.Config()
    for key, value in config.options().items():
        try:
            settings.insert_json5(key, value)
        except zenoh.ZError as error:
            quoted = _QUOTED.search(_first_line(error))
            return f"{key}: {quoted[1] if quoted else _first_line(error)}"
    return ""


#: The sentence in an error of Zenoh about a setting.
_QUOTED = re.compile(r'(?:msg: |Str\()"(.+?)(?:"|$)')


def _first_line(error: Exception) -> str:
    """The sentence of an error of Zenoh, without the place in its source; '' if it only says that no process
    answers.
    """
    text = str(error).partition("\n")[0].partition(" at /")[0].strip()
    return "" if text.startswith("Unable to connect to any of") else text
