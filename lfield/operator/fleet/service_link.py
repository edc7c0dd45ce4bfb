"""Links of a desk to the services of robots, each for several requests."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, TypeVar

from lfield.errors import AddressError, HandshakeError, KeysError, LfieldError, NoListener
from lfield.net.handshake import Handshake
from lfield.operator.observer_link import ObserverLink, PresentedCrl
from lfield.wire.messages import HandshakeRefused, Hello, Message, Ping, Pong, RevocationUpdate
from lfield.wire.service_messages import ServiceMessage

if TYPE_CHECKING:
    from lfield.net.transport import Link, Transport

A = TypeVar("A", bound=ServiceMessage)

#: Seconds for the handshake, and seconds without any message after which a link counts as broken.
HANDSHAKE_TIMEOUT, SILENCE = 8.0, 8.0
#: Seconds between two links, and seconds in which a service that is restarted by its unit listens again.
RETRY_DELAY, RESTART_TIME = 0.2, 10.0
#: Seconds without a link after which a request fails, however long its answer may take.
CONTACT = 30.0


class ServiceLink(ObserverLink):
    """Sends requests and receives their answers, in any order. `open_service_link` makes one."""

    def __init__(self, host: str, crl: PresentedCrl | None) -> None:
        self.host, self._crl = host, crl
        self._handshake: Handshake | None = None
        self._answers: asyncio.Queue[ServiceMessage | LfieldError] = asyncio.Queue()
        self._greeted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._link: Link | None = None
        #: Whether a Ping has no answer yet.
        self._is_tested = False
        self.is_closed = False

    def greet(self, link: Link) -> Handshake:
        """Start the handshake, once."""
        if self._handshake is None:
            self._link = link
            self._handshake = Handshake(Hello("observer", "observer", 0), link.identity, dialled=self.host)
            link.send(self._handshake.first_message())
        return self._handshake

    def on_message(self, link: Link, message: Message) -> None:
        """See `LinkHandler`."""
        handshake = self.greet(link)
        if handshake.peer is None:
            hello = handshake.receive(message)
            link.accept_role(hello.role)
            if self._crl is not None and hello.revoked < self._crl.number:
                link.send(RevocationUpdate(self._crl.data))
            if not self._greeted.done():
                self._greeted.set_result(None)
        elif isinstance(message, HandshakeRefused):
            # Reports begin with the name of the host.
            raise HandshakeError(message.reason)
        elif isinstance(message, Pong):
            self._is_tested = False
        elif isinstance(message, ServiceMessage):
            self._answers.put_nowait(message)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """See `LinkHandler`."""
        end = error or AddressError(link.peer, "it closed the link without an answer")
        if not self._greeted.done():
            self._greeted.set_exception(end)
        self._answers.put_nowait(end)
        self.is_closed = True

    def close(self) -> None:
        """Close the link."""
        self.is_closed = True
        if self._link is not None:
            self._link.close()

    async def wait_greeted(self) -> None:
        """Return after the handshake. Raises LfieldError."""
        async with asyncio.timeout(HANDSHAKE_TIMEOUT):
            await self._greeted

    def give_up(self) -> None:
        """Discard the result of the handshake, which is not needed any more."""
        self._greeted.cancel()

    def send(self, message: ServiceMessage) -> None:
        """Send a request. Raises AddressError on a closed link."""
        assert self._link is not None
        self._link.send(message)

    async def receive(self, kind: type[A], within: float = SILENCE) -> A:
        """The next answer of that type; others are dropped. Raises LfieldError."""
        assert self._link is not None
        try:
            async with asyncio.timeout(within):
                while True:
                    answer = await self._next_answer(self._link)
                    if isinstance(answer, LfieldError):
                        # For every later call too.
                        self._answers.put_nowait(answer)
                        raise answer
                    if isinstance(answer, kind):
                        return answer
        except TimeoutError:
            raise AddressError(self._link.peer, f"no answer within {within:g} s") from None

    async def _next_answer(self, link: Link) -> ServiceMessage | LfieldError:
        """The next answer. Meanwhile the link is tested: the robot may have left the network."""
        while True:
            try:
                async with asyncio.timeout(SILENCE):
                    return await self._answers.get()
            except TimeoutError:
                if self._is_tested:
                    return AddressError(link.peer, f"no message within {2 * SILENCE:g} s")
                self._is_tested = True
                link.send(Ping(0))

    async def ask(self, message: ServiceMessage, kind: type[A], within: float = SILENCE) -> A:
        """The answer to one request. Raises LfieldError."""
        self.send(message)
        return await self.receive(kind, within)


async def open_service_link(
    transport: Transport, address: str, host: str, crl: PresentedCrl | None
) -> ServiceLink:
    """A link to the service of `host`. Raises AddressError, HandshakeError, KeysError."""
    handler = ServiceLink(host, crl)
    link = await transport.connect(address, handler, host)
    try:
        if link.identity.kind == "anonymous":
            raise KeysError(
                f"the service at {address} accepts commands only with keys: 'lfield keys init --person NAME' "
                "makes them; --keys names their directory"
            )
        handler.greet(link)
        await handler.wait_greeted()
        return handler
    except TimeoutError:
        link.close()
        raise AddressError(address, f"no handshake within {HANDSHAKE_TIMEOUT:g} s") from None
    except BaseException:
        link.close()
        raise
    finally:
        # A failed handshake has no other reader.
        handler.give_up()


class ServiceLinks:
    """The links of a desk to the services of some hosts: made when needed, and used again.

    A link whose use has failed is closed, so no late answer counts as that of another request. Call `close`
    at the end.
    """

    def __init__(
        self, transport: Transport, addresses: Mapping[str, str], crl: PresentedCrl | None = None
    ) -> None:
        self._transport, self.addresses, self._crl = transport, addresses, crl
        self._idle: dict[str, ServiceLink] = {}

    @asynccontextmanager
    async def link(self, host: str) -> AsyncIterator[ServiceLink]:
        """A link to a host for the duration of a block. Raises AddressError, HandshakeError, KeysError."""
        link = self._idle.pop(host, None)
        if link is None or link.is_closed:
            link = await open_service_link(self._transport, self.addresses[host], host, self._crl)
        try:
            yield link
        except BaseException:
            link.close()
            raise
        if host in self._idle:
            link.close()
        else:
            self._idle[host] = link

    async def ask(
        self,
        host: str,
        message: ServiceMessage,
        kind: type[A],
        within: float,
        answered: float = SILENCE,
        *,
        restart: float = 0.0,
    ) -> A:
        """The answer to a request that may be repeated: again after broken links, for `within` seconds.

        Each answer may take `answered` seconds. A service that does not listen may be restarting: the request
        is repeated for `restart` seconds. One without a link for `CONTACT` seconds is not waited for. Raises
        AddressError, HandshakeError, KeysError.
        """
        now = asyncio.get_running_loop().time
        last: AddressError | None = None
        linked = started = now()
        try:
            async with asyncio.timeout(within):
                while True:
                    try:
                        async with self.link(host) as link:
                            try:
                                return await link.ask(message, kind, answered)
                            finally:
                                linked = now()
                    except AddressError as error:
                        if isinstance(error, NoListener) and now() - started >= restart:
                            raise
                        if now() - linked >= CONTACT:
                            raise
                        last = error
                    await asyncio.sleep(RETRY_DELAY)
        except TimeoutError:
            raise last or AddressError(self.addresses[host], f"no answer within {within:g} s") from None

    def close(self) -> None:
        """Close all links."""
        for link in self._idle.values():
            link.close()
        self._idle.clear()
