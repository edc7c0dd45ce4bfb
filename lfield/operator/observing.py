"""Links of observers to hosts: what all of them do alike, and one request over a link of its own."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from lfield.errors import AddressError, GreetingError, KeysError, LfieldError, NobodyListens, WireError
from lfield.net.greeting import Greeting
from lfield.wire.messages import Hello, Message, Refuse, Revocations
from lfield.wire.observing import (
    EmergencyStop,
    EmergencyStopped,
    Forgotten,
    OrderChallenge,
    Pause,
    Recovered,
    StartResponse,
    Status,
    named,
)
from lfield.wire.orders import HOLDS, UNKNOWN, Epochs

if TYPE_CHECKING:
    from lfield.errors import OverBudget
    from lfield.net.transport import Link, Transport
    from lfield.wire.coordinators import Transfer

T = TypeVar("T", bound=Status | EmergencyStopped | Forgotten | Recovered | StartResponse)

#: Seconds before something is asked again.
AGAIN_AFTER = 0.1
#: A message that is an order, and so has an id and the epoch of its host.
OrderMessage = EmergencyStop | Pause


@dataclass(frozen=True, slots=True)
class Request(Generic[T]):
    """What can be asked: the message, what answers it, and the seconds that a host has for that.

    What may come twice is asked `again` until then, where a link (in a flood, say) ends without an answer.
    """

    message: Message
    answer: type[T]
    bound: float
    again: bool = False


class Brought(NamedTuple):
    """A revocation list, and its number."""

    number: int
    data: bytes


class ObserverLink:
    """The handler of one link of an observer, but for messages and its end."""

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """Nobody sends one to an observer."""
        raise WireError("a coordinator was sent to an observer")

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """Nor a larger one."""
        raise WireError("a coordinator was sent to an observer")

    def on_excess(self, link: Link, error: OverBudget) -> None:
        """A host sends more than this computer can show: it is read more slowly, and closed in the end."""


def answered_challenge(message: Message, challenge: OrderChallenge) -> OrderMessage | None:
    """The order with the epoch of a challenge to it, or None where it is not to be repeated.

    A stop or a pause is still wanted. The end of one is repeated only where it named no state of the host:
    else a newer order came in between.
    """
    if not isinstance(message, OrderMessage) or message.id != challenge.id:
        return None
    if message.kind not in HOLDS and message.epoch != UNKNOWN:
        return None
    return named(message, challenge.epochs)


async def ask(
    transport: Transport,
    address: str,
    request: Request[T],
    host: str | None = None,
    brings: Brought | None = None,
) -> T:
    """The answer of the host at an address, where `host` is meant to be.

    Raises AddressError, GreetingError, WireError, KeysError, and what a bug of ours has raised.
    """
    asking, link = _Asking(request, host, brings), None
    try:
        link = await transport.connect(address, asking)
        if link.who.kind == "stranger":
            raise KeysError(
                f"the host at {address} takes commands from those alone who have keys: 'lfield keys person' "
                "makes them, and --keys, $LFIELD_KEYS or ~/.config/lfield/keys/me says where they are"
            )
        asking.greet(link)
        async with asyncio.timeout(request.bound):
            return await asking.answer
    except TimeoutError:
        raise AddressError(address, f"no answer within {request.bound:g} s") from None
    finally:
        # Also of an answer that is an error: nobody is left to take it.
        asking.answer.cancel()
        if link is not None:
            link.close()


async def ask_persistently(
    transport: Transport, address: str, request: Request[T], host: str, brings: Brought | None
) -> T:
    """As `ask`, and once more for as long as there is time for what is asked again."""
    loop = asyncio.get_running_loop()
    end = loop.time() + request.bound
    while True:
        try:
            return await ask(transport, address, request, host, brings)
        except NobodyListens:
            raise
        except AddressError:
            if not request.again or loop.time() + AGAIN_AFTER > end:
                raise
        await asyncio.sleep(AGAIN_AFTER)


class _Asking(ObserverLink, Generic[T]):
    """The handler of one link: greets, asks, keeps the answer."""

    def __init__(self, request: Request[T], host: str | None, brings: Brought | None) -> None:
        self._request, self._host, self._brings = request, host, brings
        self._greeting: Greeting | None = None
        self._asked = request.message
        self.answer: asyncio.Future[T] = asyncio.get_running_loop().create_future()

    def greet(self, link: Link) -> Greeting:
        """Greet whoever is there, once; what the host says may come before whoever connects gets its turn."""
        if self._greeting is None:
            self._greeting = Greeting(Hello("observer", "observer", 0), link.who, dialled=self._host)
            link.send(self._greeting.begin())
        return self._greeting

    def on_message(self, link: Link, message: Message) -> None:
        try:
            self._take(link, message)
        except LfieldError:
            raise
        except Exception as bug:
            # A link makes nothing of it but its end, which would be taken for the host's, and asked again.
            if not self.answer.done():
                self.answer.set_exception(bug)

    def _take(self, link: Link, message: Message) -> None:
        greeting = self.greet(link)
        if greeting.peer is None:
            hello = greeting.receive(message)
            link.greeted(hello.role)
            if self._brings is not None and hello.revoked < self._brings.number:
                link.send(Revocations(self._brings.data))
            self._ask(link, hello.epochs)
        elif isinstance(message, Refuse):
            raise GreetingError(f"{greeting.peer.host} refused: {message.reason}")
        elif isinstance(message, OrderChallenge):
            if not self.answer.done() and (again := answered_challenge(self._asked, message)):
                self._asked = again
                link.send(again)
        elif isinstance(message, self._request.answer) and not self.answer.done():
            self.answer.set_result(message)

    def _ask(self, link: Link, epochs: Epochs) -> None:
        """Send the request; an order names the epoch that the host has just told."""
        message = self._request.message
        if isinstance(message, EmergencyStop | Pause):
            message = named(message, epochs)
        self._asked = message
        link.send(message)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        if not self.answer.done():
            self.answer.set_exception(
                error or AddressError(link.peer, "it closed the link without an answer")
            )
