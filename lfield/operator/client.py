"""Observer client of hosts: requests for snapshots, and orders such as an emergency stop."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from lfield.authority import keystore
from lfield.errors import AddressError, KeysError, LfieldError, NoListener
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import UNIX, Transport, is_number
from lfield.net.zenoh.host_transport import HostTransport
from lfield.operator.observer_link import OrderMessage, PresentedCrl, Request, ask_with_retries
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.targets import HostRef, TargetTeam
from lfield.text.terminal_escape import escape_line
from lfield.wire.fields import truncate
from lfield.wire.observer_messages import (
    EmergencyStop,
    EmergencyStopResult,
    ForgetRequest,
    ForgetResponse,
    InputResult,
    Pause,
    RecoverRequest,
    RecoverResponse,
    StartResponse,
    Status,
)
from lfield.wire.order_messages import ID_SIZE
from lfield.wire.person_calls.portal_call_messages import PortalCallResult
from lfield.wire.subscription_messages import EventBatch, Subscribe

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.operator.orders.order_datagrams import OrderDatagrams
    from lfield.operator.orders.order_sender import OrderSender

_Response = ForgetResponse | RecoverResponse | StartResponse | InputResult
T = TypeVar("T", bound=EventBatch | EmergencyStopResult | _Response | PortalCallResult)
K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

#: The answer of each host by name, or the error instead.
HostAnswers = Mapping[str, T | LfieldError]
#: Sends an order to a host over an open link; raises AddressError where there is none.
OrderOnOpenLink = Callable[[str, OrderMessage], Awaitable[EmergencyStopResult]]

#: Answers are printed at this interval in seconds while another host has not answered.
REPORT_AFTER = 1.0
#: Concurrent requests to hosts of own runs and of other users' runs (a process may have 1024 descriptors),
#: and the maximum number of lines about unanswering hosts of one run of another user.
MAX_AT_ONCE, MAX_FOREIGN, MAX_LINES = 512, 128, 8

#: The largest block, in bytes; an observer receives none.
_MAX_BLOCK = 1 << 20

#: Requests the state of a host as of its newest event: a subscription that ends with its first batch. The
#: second one is repeated when a link ends, for example among many clients.
SNAPSHOT = Request(Subscribe(once=True), EventBatch, 2.0)
RETRIED_SNAPSHOT = Request(Subscribe(once=True), EventBatch, 8.0, is_retried=True)
#: The same with the records of each host about all agents; the second one for hosts that may be busy.
FULL_SNAPSHOT = Request(Subscribe(once=True, directory=True), EventBatch, 2.0)
PATIENT_SNAPSHOT = Request(Subscribe(once=True, directory=True), EventBatch, 8.0)


def emergency_stop(
    reason: str, *, lift: bool = False, draw: Callable[[int], bytes] = secrets.token_bytes
) -> Request[EmergencyStopResult]:
    """The request of an emergency stop, or with `lift` of its end, answered when the devices have confirmed.

    A lift is not retried: another operator may have stopped the team again. `draw` gives random bytes for the
    id of the order.
    """
    message = EmergencyStop(draw(ID_SIZE), truncate(reason), lift)
    return Request(message, EmergencyStopResult, 8.0, is_retried=not lift)


def forget(agent: str) -> Request[ForgetResponse]:
    """The request to declare a coordinator lost."""
    return Request(ForgetRequest(agent), ForgetResponse, 8.0)


def pause(
    *, lift: bool = False, draw: Callable[[int], bytes] = secrets.token_bytes
) -> Request[EmergencyStopResult]:
    """The request of a pause of the mission, or with `lift` of its end, which is not retried."""
    return Request(Pause(draw(ID_SIZE), lift), EmergencyStopResult, 8.0, is_retried=not lift)


def recover(order: RecoverRequest) -> Request[RecoverResponse]:
    """The request to recover a coordinator on the receiver, because its holder is permanently lost."""
    return Request(order, RecoverResponse, 8.0)


def ask_teams(
    teams: Sequence[TargetTeam], request: Request[T], keys: Path | None = None
) -> dict[HostRef, T | LfieldError]:
    """The answers of all hosts of some teams, in order; `keys` is the directory of the user's keys."""
    answers: dict[HostRef, T | LfieldError] = {}
    for team_answers in ask_in_turn(teams, request, keys):
        answers |= team_answers
    return {place: answers[place] for team in teams for place in team.host_refs}


def ask_in_turn(
    teams: Sequence[TargetTeam], request: Request[T], keys: Path | None = None
) -> Iterator[dict[HostRef, T | LfieldError]]:
    """The answers in non-empty parts, those of other users' hosts last.

    A host that does not answer delays the answers of others by at most `REPORT_AFTER`. No request is sent
    while the caller uses a part. A bug in lfield is raised after all requests.
    """
    places = {place: address for team in teams for place, address in team.host_refs.items()}
    failed: dict[HostRef, LfieldError] = {}
    known_hosts, desk = None, None
    try:
        own = own_keys(places.values(), keys)
        known_hosts = KnownHosts.read(own.authority) if own is not None else None
        transport, brings = observer_transport(own, known_hosts), presented_crl(own)
        if own is not None and known_hosts is not None and isinstance(request.message, OrderMessage):
            desk = order_sender(own, known_hosts)
    except KeysError as error:
        # Requests to hosts of this computer need no keys: it may be a stop.
        transport, brings = observer_transport(), None
        failed = {place: error for place, address in places.items() if not address.startswith(UNIX)}
    requested = {place: address for place, address in places.items() if place not in failed}
    with asyncio.Runner() as runner:
        asking = runner.run(_in_loop(lambda: _Requests(transport, requested, request, brings, desk)))
        answers: dict[HostRef, T | LfieldError] = {**failed}
        queried: set[HostRef] = set()
        complete = False
        while not complete:
            complete = runner.run(asking.believed_within(REPORT_AFTER))
            answers |= asking.answered
            part = [place for place in places if not place.user and place in answers.keys() - queried]
            queried.update(part)
            if part:
                yield {place: answers[place] for place in part}
        answers |= runner.run(asking.foreign())
        if others := {place: answers[place] for place in places if place.user}:
            yield others
    if known_hosts is not None:
        _remember(known_hosts, answers)
    for bug in asking.bugs:
        raise bug


def order_sender(keys: Keys, known: KnownHosts) -> OrderSender:
    """The sender of orders as datagrams. Raises KeysError."""
    # Most commands send no order, and cryptography is large.
    from lfield.operator.orders.order_sender import OrderSender

    return OrderSender(keys, known)


def _remember(known: KnownHosts, answers: Mapping[HostRef, T | LfieldError]) -> None:
    """Store the epochs of the answers, so that the next stop needs one round trip."""
    for place, answer in answers.items():
        reply = answer.snapshot if isinstance(answer, EventBatch) else answer
        if isinstance(reply, Status | EmergencyStopResult) and not place.user:
            known.learn(place.host, epochs=reply.epochs)
    known.save()


def by_host(found: Mapping[HostRef, V], team: TargetTeam) -> dict[str, V]:
    """The results of the hosts of one team, by host."""
    return {place.host: found[place] for place in team.host_refs}


def is_reached(answer: T | LfieldError) -> bool:
    """Whether a program listens at the address, even if it refused the request."""
    return not isinstance(answer, NoListener)


def unanswered(answers: HostAnswers[T]) -> dict[str, LfieldError]:
    """The hosts that did not answer, with the reasons."""
    return {host: answer for host, answer in answers.items() if isinstance(answer, LfieldError)}


def unanswered_by_name(
    answers: Mapping[HostRef, T | LfieldError], names: Mapping[HostRef, str]
) -> dict[str, LfieldError]:
    """The hosts that did not answer by display name; one entry for many hosts of another user's run."""
    found = {place: answer for place, answer in answers.items() if isinstance(answer, LfieldError)}
    counts = Counter(place.run for place in found if place.user)
    reasons: dict[str, LfieldError] = {}
    for place, reason in found.items():
        count = counts[place.run] if place.user else 0
        reasons.setdefault(f"{count} hosts of {place.run}" if count > MAX_LINES else names[place], reason)
    return reasons


def print_unanswered(hosts: Mapping[str, LfieldError], meaning: str = "") -> None:
    """A line on stderr for each host that did not answer."""
    for host, reason in hosts.items():
        print(escape_line(f"{host}: {meaning}{reason}"), file=sys.stderr)


def observer_transport(
    keys: Keys | None = None, known: KnownHosts | None = None, connect_timeout: float = 2.0
) -> HostTransport:
    """The transport of links to hosts; over a network it needs keys. `connect_timeout` is in seconds.

    `known` stores the certificates of hosts. Raises KeysError.
    """
    if keys is None:
        return HostTransport(TcpTransport(_MAX_BLOCK, connect_timeout=connect_timeout), connect_timeout)
    # Most commands ask hosts of this computer, and TLS is slow to load.
    from lfield.net.tls import TlsIdentity

    tls = TlsIdentity(keys, known.on_verified) if known is not None else TlsIdentity(keys)
    return HostTransport(TcpTransport(_MAX_BLOCK, tls, connect_timeout=connect_timeout), connect_timeout)


def own_keys(addresses: Iterable[str], named: Path | None) -> Keys | None:
    """The keys of this user; None without any, or when no address is on a network. Raises KeysError."""
    if all(address.startswith(UNIX) for address in addresses):
        return None
    found = keystore.find_keys("person", keystore.OWN, named, os.environ)
    return keystore.read_keys(found, "person") if found is not None else None


def presented_crl(keys: Keys | None) -> PresentedCrl | None:
    """The certificate revocation list of the keys, for hosts with an older one. Raises KeysError."""
    if keys is None or not keys.revoked:
        return None
    # Rare, and cryptography is large.
    from lfield.authority.certificate_reader import revoked_in

    return PresentedCrl(revoked_in(keys.revoked, keys.authority).number, keys.revoked)


async def ask_all(
    transport: Transport,
    addresses: Mapping[K, str],
    request: Request[T],
    crl: PresentedCrl | None = None,
    sender: OrderSender | None = None,
    open_link: OrderOnOpenLink | None = None,
    on_answer: Callable[[K, T | LfieldError], None] = lambda key, answer: None,
) -> dict[K, T | LfieldError]:
    """The answer of every host by its key; `crl` is presented to hosts with an older list.

    An order is also sent as datagrams, by a `sender`, and over open links, by `open_link`. Each answer is
    passed to `on_answer` when it comes. All hosts of other users' runs share the time-out of one host. A bug
    is raised as by `ask_in_turn`.
    """
    asking = _Requests(transport, addresses, request, crl, sender, open_link, on_answer)
    answers = await asking.trusted() | await asking.foreign()
    for bug in asking.bugs:
        raise bug
    return {key: answers[key] for key in addresses}


async def _in_loop(make: Callable[[], _Requests[K, T]]) -> _Requests[K, T]:
    return make()


class _Requests(Generic[K, T]):
    """Concurrent requests to many hosts, in the running loop; fewer to those of other users' runs."""

    def __init__(
        self,
        transport: Transport,
        addresses: Mapping[K, str],
        request: Request[T],
        crl: PresentedCrl | None,
        sender: OrderSender | None = None,
        open_link: OrderOnOpenLink | None = None,
        on_answer: Callable[[K, T | LfieldError], None] = lambda key, answer: None,
    ) -> None:
        self._transport, self._addresses = transport, addresses
        self._request, self._crl = request, crl
        self._sender, self._open_link, self._on_answer = sender, open_link, on_answer
        self._answers: dict[K, T | LfieldError] = {}
        #: Bugs, raised after all requests.
        self.bugs: list[Exception] = []
        loop = asyncio.get_running_loop()
        self._end = loop.time() + request.timeout
        users: dict[str, list[K]] = defaultdict(list)
        for key in addresses:
            users[_user(key)].append(key)
        believed = users.pop("", [])
        #: The datagrams of each run's hosts.
        self._orders = self._send_orders(believed)
        # First, so that they get their descriptors before the others.
        self._trusted = loop.create_task(self._each(believed, MAX_AT_ONCE))
        self._trusted.add_done_callback(self._end_datagrams)
        share = max(1, MAX_FOREIGN // max(1, len(users)))
        self._foreign = [loop.create_task(self._each(keys, share)) for keys in users.values()]

    def _send_orders(self, keys: Sequence[K]) -> dict[str, OrderDatagrams]:
        """Start to send an order as datagrams to the hosts on a network."""
        message, desk = self._request.message, self._sender
        if desk is None or not isinstance(message, OrderMessage):
            return {}
        runs: dict[str, dict[str, str]] = defaultdict(dict)
        for key in keys:
            if not self._addresses[key].startswith(UNIX):
                runs[_run(key)][_host(key)] = self._addresses[key]
        return {run: desk.send(message, addresses) for run, addresses in runs.items()}

    def _end_datagrams(self, _: object) -> None:
        """Stop the datagrams when no request is left, also after an interrupt."""
        for datagrams in self._orders.values():
            assert self._sender is not None
            self._sender.finish(datagrams)

    async def _each(self, keys: Sequence[K], limit: int) -> None:
        """Send requests in order, at most `limit` at the same time."""
        remaining = iter(keys)

        async def send_remaining() -> None:
            for key in remaining:
                self._answers[key] = answer = await self._answer_of(key)
                self._on_answer(key, answer)

        await asyncio.gather(*(send_remaining() for _ in range(min(limit, len(keys)))))

    async def _answer_of(self, key: K) -> T | LfieldError:
        address = self._addresses[key]
        if _user(key) and not (address.startswith(UNIX) or is_number(address)):
            # A name look-up blocks a thread for as long as the name server takes.
            return AddressError(
                address, "an address of another user's run: name the run with --run to use it"
            )
        try:
            return await self._ask(key, address)
        except LfieldError as error:
            return error
        except Exception as bug:
            self.bugs.append(bug)
            return LfieldError(f"bug in lfield: {type(bug).__name__}: {bug}")

    async def _ask(self, key: K, address: str) -> T:
        host, message = _host(key), self._request.message
        new_link = partial(ask_with_retries, self._transport, address, self._request, host, self._crl)
        if not isinstance(message, OrderMessage) or _user(key):
            return await new_link()
        datagrams = None if address.startswith(UNIX) else self._orders.get(_run(key))
        over_open_link = None if self._open_link is None else partial(self._open_link, host, message)
        if datagrams is None and over_open_link is None:
            return await new_link()
        from lfield.operator.orders.path_race import first_answer

        # The first answer counts.
        return cast("T", await first_answer(host, cast("Any", new_link), datagrams, over_open_link))

    @property
    def answered(self) -> Mapping[K, T | LfieldError]:
        """The answers so far, without those of other users' hosts."""
        return {key: answer for key, answer in self._answers.items() if not _user(key)}

    async def believed_within(self, seconds: float) -> bool:
        """Wait for the answers of `trusted` until a time-out; returns whether they are complete."""
        done, _ = await asyncio.wait([self._trusted], timeout=seconds)
        for task in done:
            task.result()
        return bool(done)

    async def trusted(self) -> dict[K, T | LfieldError]:
        """The answers of the hosts of own runs."""
        await self._trusted
        return {key: self._answers[key] for key in self._addresses if not _user(key)}

    async def foreign(self) -> dict[K, T | LfieldError]:
        """The answers of other users' hosts, an error for each that has not answered by the time-out."""
        if self._foreign:
            remaining = self._end - asyncio.get_running_loop().time()
            _, late = await asyncio.wait(self._foreign, timeout=max(0.0, remaining))
            for task in late:
                task.cancel()
            await asyncio.gather(*self._foreign, return_exceptions=True)
        return {
            key: self._answers.get(key, self._timeout_error(key)) for key in self._addresses if _user(key)
        }

    def _timeout_error(self, key: K) -> LfieldError:
        reason = f"no answer of the runs of other users within {self._request.timeout:g} s"
        return AddressError(self._addresses[key], reason)


def _host(key: Hashable) -> str:
    return key.host if isinstance(key, HostRef) else str(key)


def _run(key: Hashable) -> str:
    return key.run if isinstance(key, HostRef) else ""


def _user(key: Hashable) -> str:
    return key.user if isinstance(key, HostRef) else ""
