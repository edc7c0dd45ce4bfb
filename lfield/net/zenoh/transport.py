"""Transport over a Zenoh fabric: "zenoh:NAME:PORT". The fabric need not be trusted: TLS runs end to end.

The links are those of TCP (`stream_link`, `tls_link`), over numbered streams.
"""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

from lfield.errors import AddressError, MissingZenoh, NoListener, ZenohUnreachable
from lfield.net.transport import ZENOH, is_zenoh, join_address, split_address
from lfield.net.zenoh.endpoint import ZenohEndpoint
from lfield.text import log_messages

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.net.stream_link import StreamLink
    from lfield.net.transport import Link, LinkHandler
    from lfield.net.zenoh.config import ZenohConfig
    from lfield.net.zenoh.pipe import ZenohPipe
    from lfield.text.log_messages import LogLine

#: Seconds for the session before a listener waits for it in the background, and seconds without an answer
#: before a listener is looked up: the name may not have reached every router.
SESSION_TIMEOUT, LOOK_UP_AFTER = 2.0, 1.0
#: Ports of listeners without a port.
FREE_PORTS = range(49152, 65536)
#: Attempts to find a free port.
PORT_ATTEMPTS = 20


class NewLink(Protocol):
    """Makes a link without its connection; see `TcpTransport.new_link`."""

    def __call__(self, on_link: Callable[[Link], LinkHandler], *, calls: bool) -> StreamLink:
        """The link, dialled if `calls`."""


class ZenohListener:
    """A name at which streams are accepted."""

    def __init__(self, endpoint: ZenohEndpoint, name: str, port: int) -> None:
        self._endpoint, self._name, self._port = endpoint, name, port

    @property
    def address(self) -> str:
        """See `Listener.address`."""
        return join_address(ZENOH + self._name, self._port)

    def close(self) -> None:
        """See `Listener.close`."""
        self._endpoint.stop_listening(self._name, self._port)


class ZenohTransport:
    """Hosts by their names in a fabric, in a running loop. `new_link` makes the links.

    `connect_timeout`: seconds to open a stream, and again for the handshake of its link. The session is
    opened at the first use, and again until it succeeds.
    """

    def __init__(self, config: ZenohConfig, new_link: NewLink, connect_timeout: float = 5.0) -> None:
        self._config, self._new_link, self._connect_timeout = config, new_link, connect_timeout
        self._endpoint: ZenohEndpoint | None = None
        self._note: Callable[[LogLine], None] = lambda line: None

    def log_to(self, note: Callable[[LogLine], None]) -> None:
        """Write log lines with `note` from now on."""
        self._note = note

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> ZenohListener:
        """See `Transport.listen`. Without a router, it listens as soon as a router is connected.

        Raises MissingZenoh, and AddressError for a name that another program has.
        """
        endpoint = self._opened_endpoint(address)
        name, port = _split(address)
        port = await self._free_port(endpoint, name, port, address)

        def on_pipe(pipe: ZenohPipe) -> None:
            pipe.start(self._new_link(on_link, calls=False))

        endpoint.listen(name, port, on_pipe)
        if not endpoint.is_open.is_set():
            self._note(log_messages.NO_ZENOH.line(address=address, reason=self._why_closed(endpoint)))
        return ZenohListener(endpoint, name, port)

    async def connect(self, address: str, handler: LinkHandler, host: str = "") -> StreamLink:
        """See `Transport.connect`. Raises MissingZenoh and ZenohUnreachable too."""
        endpoint = self._opened_endpoint(address)
        name, port = _split(address)
        try:
            async with asyncio.timeout(self._connect_timeout):
                await endpoint.is_open.wait()
        except TimeoutError:
            raise ZenohUnreachable(address, self._why_closed(endpoint)) from None
        pipe = endpoint.dial(name, port)
        try:
            await self._require_open(endpoint, pipe, address)
            link = self._new_link(lambda _: handler, calls=True)
            pipe.start(link)
            async with asyncio.timeout(self._connect_timeout):
                await link.ready()
        except TimeoutError:
            pipe.abort()
            raise AddressError(address, f"no answer within {self._connect_timeout:g} s") from None
        except BaseException:
            pipe.abort()
            raise
        return link

    def close(self) -> None:
        """Close the session; open links end without a message to their peers."""
        if self._endpoint is not None:
            self._endpoint.close()
            self._endpoint = None

    def _opened_endpoint(self, address: str) -> ZenohEndpoint:
        _split(address)
        if self._endpoint is None:
            try:
                self._endpoint = ZenohEndpoint(self._config)
            except ImportError:
                raise MissingZenoh(address) from None
            except ValueError as error:
                reason = f"Zenoh rejects a setting in the section 'zenoh' of the inventory: {error}"
                raise AddressError(address, reason) from None
        return self._endpoint

    async def _free_port(self, endpoint: ZenohEndpoint, name: str, port: int, address: str) -> int:
        """The port, or a free one for 0. Raises AddressError if another program has it."""
        ports = [port] if port else random.sample(FREE_PORTS, PORT_ATTEMPTS)
        with suppress(TimeoutError):
            async with asyncio.timeout(SESSION_TIMEOUT):
                for each in ports:
                    if endpoint.has_listener(name, each):
                        continue
                    exists, _ = await endpoint.find(name, each)
                    if not exists:
                        return each
            reason = (
                "the port is in use; stop the program that has it, or choose another (after a loss of power "
                "or of the network a router keeps it for 10 s)"
            )
            raise AddressError(address, reason)
        return ports[0]

    async def _require_open(self, endpoint: ZenohEndpoint, pipe: ZenohPipe, address: str) -> None:
        """Return when the listener has accepted a stream. Raises AddressError and TimeoutError."""
        async with asyncio.timeout(self._connect_timeout):
            done, _ = await asyncio.wait([pipe.opened], timeout=LOOK_UP_AFTER)
            if not done:
                exists, neighbours = await endpoint.find(*_split(address))
                if not neighbours:
                    raise ZenohUnreachable(address, "no router or peer of the Zenoh fabric is connected")
                if not exists and not pipe.opened.done():
                    raise NoListener(address)
            if reason := await asyncio.shield(pipe.opened):
                raise AddressError(address, f"the stream was not opened: {reason}")

    def _why_closed(self, endpoint: ZenohEndpoint) -> str:
        """The reason why there is no session."""
        where = " or ".join(self._config.connect) or "the network"
        detail = f" ({endpoint.failure})" if endpoint.failure else ""
        return f"no Zenoh router answers at {where}{detail}; lfield retries"


def _split(address: str) -> tuple[str, int]:
    """Name and port of an address. Raises AddressError."""
    host, port = split_address(address)
    if not is_zenoh(address):
        raise AddressError(address, f"an address in Zenoh is {ZENOH}NAME or {ZENOH}NAME:PORT")
    return host.removeprefix(ZENOH), port
