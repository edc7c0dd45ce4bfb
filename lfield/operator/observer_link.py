"""Links of observers to hosts: the common handler, and one request over a link of its own."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from msgspec import Struct

from lfield.errors import AddressError, HandshakeError, KeysError, LfieldError, NoListener, WireError
from lfield.net.handshake import Handshake
from lfield.wire.messages import HandshakeRefused, Hello, Message, RevocationUpdate
from lfield.wire.observer_messages import (
    EmergencyStop,
    EmergencyStopResult,
    ForgetResponse,
    InputLine,
    InputResult,
    OrderChallenge,
    Pause,
    RecoverResponse,
    StartResponse,
    with_epoch,
)
from lfield.wire.order_messages import HOLDS, UNKNOWN_EPOCH, Epochs
from lfield.wire.person_calls.portal_call_messages import PortalCallResult
from lfield.wire.subscription_messages import EventBatch

if TYPE_CHECKING:
    from lfield.errors import CpuBudgetExceeded
    from lfield.net.transport import Link, Transport
    from lfield.wire.coordinator_messages import Transfer

_Response = ForgetResponse | RecoverResponse | StartResponse | InputResult
T = TypeVar("T", bound=EventBatch | EmergencyStopResult | _Response | PortalCallResult)

#: Seconds between two attempts.
RETRY_DELAY = 0.1
#: A message that is an order, and so has an id and the epoch of its host.
OrderMessage = EmergencyStop | Pause


class Request(Struct, Generic[T], frozen=True):
    """A request: the message, the type of its answer, and the time-out in seconds.

    `is_retried`: an idempotent request, repeated until the time-out when a link ends without an answer (in a
    flood of connections, for example).
    """

    message: Message
    answer: type[T]
    timeout: float
    is_retried: bool = False


def input_line(agent: str, text: str) -> Request[InputResult]:
    """Gives an agent of the host a line of input, of at most `MAX_INPUT` characters.

    The request is not retried: a repeated line could answer another question.
    """
    return Request(InputLine(agent, text), InputResult, 8.0)


class PresentedCrl(NamedTuple):
    """A revocation list, and its number."""

    number: int
    data: bytes


class ObserverLink:
    """The handler of one link of an observer, but for messages and its end."""

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """Raises WireError: an observer receives no coordinators."""
        raise WireError("a coordinator was sent to an observer")

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """Raises WireError, as `on_transfer`."""
        raise WireError("a coordinator was sent to an observer")

    def on_excess(self, link: Link, error: CpuBudgetExceeded) -> None:
        """Ignores the excess: a host that sends too much is read more slowly, then closed."""


def answer_challenge(message: Message, challenge: OrderChallenge) -> OrderMessage | None:
    """The order with the epoch of a challenge, or None if it must not be repeated.

    A stop or a pause is repeated. The end of one is repeated only if it named no state of the host:
    otherwise a newer order came in between.
    """
    if not isinstance(message, OrderMessage) or message.id != challenge.id:
        return None
    if message.kind not in HOLDS and message.epoch != UNKNOWN_EPOCH:
        return None
    return with_epoch(message, challenge.epochs)


async def send_request(
    transport: Transport,
    address: str,
    request: Request[T],
    host: str | None = None,
    crl: PresentedCrl | None = None,
) -> T:
    """The answer of the host at an address; `host` is its expected name.

    Raises AddressError, HandshakeError, WireError, KeysError, and any exception of a bug in lfield.
    """
    asking, link = _RequestLink(request, host, crl), None
    try:
        link = await transport.connect(address, asking, host or "")
        if link.identity.kind == "anonymous":
            raise KeysError(
                f"the host at {address} accepts commands only with keys: 'lfield keys person' "
                "creates them; put them into ~/.config/lfield/keys/me, or name their folder with --keys"
            )
        asking.greet(link)
        async with asyncio.timeout(request.timeout):
            return await asking.answer
    except TimeoutError:
        raise AddressError(address, f"no answer within {request.timeout:g} s") from None
    finally:
        # Also when the answer is an error: the future has no other reader.
        asking.answer.cancel()
        if link is not None:
            link.close()


async def ask_with_retries(
    transport: Transport, address: str, request: Request[T], host: str, brings: PresentedCrl | None
) -> T:
    """`send_request` with retries until the time-out, for requests that may be repeated."""
    loop = asyncio.get_running_loop()
    end = loop.time() + request.timeout
    while True:
        try:
            return await send_request(transport, address, request, host, brings)
        except NoListener:
            raise
        except AddressError:
            if not request.is_retried or loop.time() + RETRY_DELAY > end:
                raise
        await asyncio.sleep(RETRY_DELAY)


class _RequestLink(ObserverLink, Generic[T]):
    """The handler of one link: handshake, request, answer."""

    def __init__(self, request: Request[T], host: str | None, crl: PresentedCrl | None) -> None:
        self._request, self._host, self._crl = request, host, crl
        self._greeting: Handshake | None = None
        self._has_sent = request.message
        self.answer: asyncio.Future[T] = asyncio.get_running_loop().create_future()

    def greet(self, link: Link) -> Handshake:
        """Start the handshake, once; a message may arrive before the connecting task runs."""
        if self._greeting is None:
            self._greeting = Handshake(Hello("observer", "observer", 0), link.identity, dialled=self._host)
            link.send(self._greeting.first_message())
        return self._greeting

    def on_message(self, link: Link, message: Message) -> None:
        try:
            self._on_greeted(link, message)
        except LfieldError:
            raise
        except Exception as bug:
            # An exception would only end the link, like an end by the host, and the request would be
            # repeated.
            if not self.answer.done():
                self.answer.set_exception(bug)

    def _on_greeted(self, link: Link, message: Message) -> None:
        greeting = self.greet(link)
        if greeting.peer is None:
            hello = greeting.receive(message)
            link.accept_role(hello.role)
            if self._crl is not None and hello.revoked < self._crl.number:
                link.send(RevocationUpdate(self._crl.data))
            self._send_request(link, hello.epochs)
        elif isinstance(message, HandshakeRefused):
            raise HandshakeError(f"{greeting.peer.host} refused: {message.reason}")
        elif isinstance(message, OrderChallenge):
            if not self.answer.done() and (answer := answer_challenge(self._has_sent, message)):
                self._has_sent = answer
                link.send(answer)
        elif isinstance(message, EventBatch) and message.snapshot is None:
            raise WireError(f"{greeting.peer.host} has sent no snapshot")
        elif isinstance(message, self._request.answer) and not self.answer.done():
            self.answer.set_result(message)

    def _send_request(self, link: Link, epochs: Epochs) -> None:
        """Send the request; an order carries the epoch of the host's handshake."""
        message = self._request.message
        if isinstance(message, EmergencyStop | Pause):
            message = with_epoch(message, epochs)
        self._has_sent = message
        link.send(message)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        if not self.answer.done():
            self.answer.set_exception(
                error or AddressError(link.peer, "it closed the link without an answer")
            )
