"""Asks hosts for something, as somebody who is no host: their status, or an emergency stop."""

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

from lfield.authority import folder
from lfield.errors import AddressError, KeysError, LfieldError, NobodyListens
from lfield.net.tcp import TcpTransport
from lfield.net.transport import UNIX, Transport, is_number
from lfield.operator.addressed import Party, Place
from lfield.operator.observing import Brought, OrderMessage, Request, ask_persistently
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.text.visible import in_one_line
from lfield.wire.fields import clip
from lfield.wire.observing import (
    EmergencyStop,
    EmergencyStopped,
    Forget,
    Forgotten,
    Pause,
    Recover,
    Recovered,
    StartResponse,
    Status,
    StatusRequest,
)
from lfield.wire.orders import ID_SIZE

if TYPE_CHECKING:
    from lfield.authority.keys import Keys
    from lfield.operator.orders.datagrams import Datagrams
    from lfield.operator.orders.desk import Desk

T = TypeVar("T", bound=Status | EmergencyStopped | Forgotten | Recovered | StartResponse)
K = TypeVar("K", bound=Hashable)

#: For each host by its name what it answered, or the error that stood in the way.
Answers = Mapping[str, T | LfieldError]

#: Gives an order to a host over the connection that stands; raises AddressError where there is none.
Standing = Callable[[str, OrderMessage], Awaitable[EmergencyStopped]]

#: Answers are printed at this interval in seconds while another host has not answered.
TOLD_AFTER = 1.0
#: So many hosts are asked at a time, and so many that are in runs of other users: a process may have 1024
#: descriptors. Of one such run so many hosts that did not answer get a line each.
AT_ONCE, BESIDE, MOST_LINES = 512, 128, 8

#: An observer is sent no coordinators; this is the largest block it would read, in bytes.
_MAX_BLOCK = 1 << 20


STATUS = Request(StatusRequest(), Status, 2.0)


def patiently() -> Request[Status]:
    """The status of hosts that may be busy: what they would say is waited for, since others cannot say it."""
    return Request(StatusRequest(), Status, 8.0)


def emergency_stop(
    reason: str, *, lift: bool = False, draw: Callable[[int], bytes] = secrets.token_bytes
) -> Request[EmergencyStopped]:
    """An emergency stop, or its end. It takes as long as the devices take to confirm it.

    Its end is asked for once only: somebody else may press the next one meanwhile. `draw` gives random bytes,
    so many, for the id of the order.
    """
    message = EmergencyStop(draw(ID_SIZE), clip(reason), lift)
    return Request(message, EmergencyStopped, 8.0, again=not lift)


def forget(agent: str) -> Request[Forgotten]:
    """A person's word that a coordinator is lost."""
    return Request(Forget(agent), Forgotten, 8.0)


def pause(
    *, lift: bool = False, draw: Callable[[int], bytes] = secrets.token_bytes
) -> Request[EmergencyStopped]:
    """Pause the mission, or let it go on, once only. It takes as long as the devices take to confirm it."""
    return Request(Pause(draw(ID_SIZE), lift), EmergencyStopped, 8.0, again=not lift)


def recover(word: Recover) -> Request[Recovered]:
    """A person's word that the holder of a coordinator is gone for good."""
    return Request(word, Recovered, 8.0)


def ask_parties(
    parties: Sequence[Party], request: Request[T], keys: Path | None = None
) -> dict[Place, T | LfieldError]:
    """What all hosts of some parties answer, in their order. `keys` is where those of this user should be."""
    answers: dict[Place, T | LfieldError] = {}
    for some in asked_in_turn(parties, request, keys):
        answers |= some
    return {place: answers[place] for party in parties for place in party.places}


def asked_in_turn(
    parties: Sequence[Party], request: Request[T], keys: Path | None = None
) -> Iterator[dict[Place, T | LfieldError]]:
    """The same in parts, none of them empty, the answers of other users' hosts last.

    A host that does not answer does not delay the answers of others by more than TOLD_AFTER. Nothing is sent
    while the caller uses a part. A bug of lfield is raised when all hosts have been asked.
    """
    places = {place: address for party in parties for place, address in party.places.items()}
    failed: dict[Place, LfieldError] = {}
    known, desk = None, None
    try:
        own = own_keys(places.values(), keys)
        known = KnownHosts.read(own.authority) if own is not None else None
        transport, brings = observer(own, known), brought(own)
        if own is not None and known is not None and isinstance(request.message, OrderMessage):
            desk = desk_with(own, known)
    except KeysError as error:
        # Whoever is on this computer must hear it all the same: it may be a stop.
        transport, brings = observer(), None
        failed = {place: error for place, address in places.items() if not address.startswith(UNIX)}
    asked = {place: address for place, address in places.items() if place not in failed}
    with asyncio.Runner() as runner:
        asking = runner.run(_in_loop(lambda: _AskingAll(transport, asked, request, brings, desk)))
        answers: dict[Place, T | LfieldError] = {**failed}
        told: set[Place] = set()
        complete = False
        while not complete:
            complete = runner.run(asking.believed_within(TOLD_AFTER))
            answers |= asking.answered
            part = [place for place in places if not place.user and place in answers.keys() - told]
            told.update(part)
            if part:
                yield {place: answers[place] for place in part}
        answers |= runner.run(asking.others())
        if others := {place: answers[place] for place in places if place.user}:
            yield others
    if known is not None:
        _remember(known, answers)
    for bug in asking.bugs:
        raise bug


def desk_with(keys: Keys, known: KnownHosts) -> Desk:
    """What orders are given with as datagrams. Raises KeysError for keys that cannot be used."""
    # Most commands give no order, and cryptography is large.
    from lfield.operator.orders.desk import Desk

    return Desk(keys, known)


def _remember(known: KnownHosts, answers: Mapping[Place, T | LfieldError]) -> None:
    """Keep the epochs that hosts have told, so that the next stop needs one round trip."""
    for place, answer in answers.items():
        if isinstance(answer, Status | EmergencyStopped) and not place.user:
            known.learn(place.host, epochs=answer.epochs)
    known.save()


def by_host(answers: Mapping[Place, T | LfieldError], party: Party) -> Answers[T]:
    """The answers of one party by host."""
    return {place.host: answers[place] for place in party.places}


def reached(answer: T | LfieldError) -> bool:
    """Whether somebody was there, whatever came of it."""
    return not isinstance(answer, NobodyListens)


def silent(answers: Answers[T]) -> dict[str, LfieldError]:
    """The hosts that did not answer, with the reasons."""
    return {host: answer for host, answer in answers.items() if isinstance(answer, LfieldError)}


def heard(answers: Answers[T]) -> dict[str, T]:
    """Those that did, with what they said."""
    return {host: answer for host, answer in answers.items() if not isinstance(answer, LfieldError)}


def unheard(answers: Mapping[Place, T | LfieldError], names: Mapping[Place, str]) -> dict[str, LfieldError]:
    """The same by what hosts are called. Of many that another user's run claims there is one line."""
    found = {place: answer for place, answer in answers.items() if isinstance(answer, LfieldError)}
    counts = Counter(place.run for place in found if place.user)
    told: dict[str, LfieldError] = {}
    for place, why in found.items():
        count = counts[place.run] if place.user else 0
        told.setdefault(f"{count} hosts of {place.run}" if count > MOST_LINES else names[place], why)
    return told


def tell_silent(hosts: Mapping[str, LfieldError], meaning: str = "") -> None:
    """A line on stderr for each host that did not answer."""
    for host, why in hosts.items():
        print(in_one_line(f"{host}: {meaning}{why}"), file=sys.stderr)


def observer(
    keys: Keys | None = None, known: KnownHosts | None = None, connect_timeout: float = 2.0
) -> TcpTransport:
    """What links to hosts are made with; `connect_timeout` in seconds. Over a network it takes keys.

    `known` learns the certificates of hosts.

    Raises KeysError for keys that cannot be used.
    """
    if keys is None:
        return TcpTransport(_MAX_BLOCK, connect_timeout=connect_timeout)
    # Most commands ask on this computer, and TLS takes its time to load.
    from lfield.net.tls import Tls

    tls = Tls(keys, known.seen) if known is not None else Tls(keys)
    return TcpTransport(_MAX_BLOCK, tls, connect_timeout=connect_timeout)


def own_keys(addresses: Iterable[str], named: Path | None) -> Keys | None:
    """The keys of this user; None where there are none, or nobody is asked over a network.

    Raises KeysError.
    """
    if all(address.startswith(UNIX) for address in addresses):
        return None
    found = folder.find("person", folder.ME, named, os.environ)
    return folder.read(found, "person") if found is not None else None


def brought(keys: Keys | None) -> Brought | None:
    """The revocation list of somebody's keys, for hosts that have an older one. Raises KeysError."""
    if keys is None or not keys.revoked:
        return None
    # It is seldom there, and cryptography is large.
    from lfield.authority.reading import revoked_in

    return Brought(revoked_in(keys.revoked, keys.authority).number, keys.revoked)


async def ask_all(
    transport: Transport,
    addresses: Mapping[K, str],
    request: Request[T],
    brings: Brought | None = None,
    desk: Desk | None = None,
    standing: Standing | None = None,
    on_answer: Callable[[K, T | LfieldError], None] = lambda key, answer: None,
) -> dict[K, T | LfieldError]:
    """The answer of every host by its key; `brings` a revocation list to them.

    An order is also given as datagrams, by a `desk`, and over connections that are `standing`. Each answer is
    passed to `on_answer` when it comes. Those of other users' runs have no more time all together than one
    host has. A bug is raised as by `asked_in_turn`.
    """
    asking = _AskingAll(transport, addresses, request, brings, desk, standing, on_answer)
    answers = await asking.believed() | await asking.others()
    for bug in asking.bugs:
        raise bug
    return {key: answers[key] for key in addresses}


async def _in_loop(make: Callable[[], _AskingAll[K, T]]) -> _AskingAll[K, T]:
    return make()


class _AskingAll(Generic[K, T]):
    """Hosts that are being asked, in the running loop: many at once, and those of each other user beside."""

    def __init__(
        self,
        transport: Transport,
        addresses: Mapping[K, str],
        request: Request[T],
        brings: Brought | None,
        desk: Desk | None = None,
        standing: Standing | None = None,
        on_answer: Callable[[K, T | LfieldError], None] = lambda key, answer: None,
    ) -> None:
        self._transport, self._addresses = transport, addresses
        self._request, self._brings = request, brings
        self._desk, self._standing, self._on_answer = desk, standing, on_answer
        self._answers: dict[K, T | LfieldError] = {}
        #: Exceptions that nobody means to raise: one host's must not keep the others from being asked.
        self.bugs: list[Exception] = []
        loop = asyncio.get_running_loop()
        self._end = loop.time() + request.bound
        users: dict[str, list[K]] = defaultdict(list)
        for key in addresses:
            users[_user(key)].append(key)
        believed = users.pop("", [])
        #: The datagrams of each run's hosts.
        self._given = self._give(believed)
        # First, so that their links are there before others can take descriptors.
        self._believed = loop.create_task(self._each(believed, AT_ONCE))
        self._believed.add_done_callback(self._end_datagrams)
        share = max(1, BESIDE // max(1, len(users)))
        self._others = [loop.create_task(self._each(keys, share)) for keys in users.values()]

    def _give(self, keys: Sequence[K]) -> dict[str, Datagrams]:
        """Begin to send an order to the hosts over a network. At Unix sockets no datagram arrives."""
        message, desk = self._request.message, self._desk
        if desk is None or not isinstance(message, OrderMessage):
            return {}
        runs: dict[str, dict[str, str]] = defaultdict(dict)
        for key in keys:
            if not self._addresses[key].startswith(UNIX):
                runs[_run(key)][_host(key)] = self._addresses[key]
        return {run: desk.give(message, addresses) for run, addresses in runs.items()}

    def _end_datagrams(self, _: object) -> None:
        """End the datagrams when the hosts are asked no more, also after an interrupt."""
        for given in self._given.values():
            assert self._desk is not None
            self._desk.taken(given)

    async def _each(self, keys: Sequence[K], most: int) -> None:
        """Ask so many at a time, in their order."""
        left = iter(keys)

        async def some() -> None:
            for key in left:
                self._answers[key] = answer = await self._one(key)
                self._on_answer(key, answer)

        await asyncio.gather(*(some() for _ in range(min(most, len(keys)))))

    async def _one(self, key: K) -> T | LfieldError:
        address = self._addresses[key]
        if _user(key) and not (address.startswith(UNIX) or is_number(address)):
            # Looking up names takes threads, and as long as whoever owns the name likes.
            return AddressError(address, "another user's run names it: name that with --run to ask there")
        try:
            return await self._ask(key, address)
        except LfieldError as error:
            return error
        except Exception as bug:
            self.bugs.append(bug)
            return LfieldError(f"a bug in lfield itself: {type(bug).__name__}: {bug}")

    async def _ask(self, key: K, address: str) -> T:
        host, message = _host(key), self._request.message
        new_link = partial(ask_persistently, self._transport, address, self._request, host, self._brings)
        if not isinstance(message, OrderMessage) or _user(key):
            return await new_link()
        given = None if address.startswith(UNIX) else self._given.get(_run(key))
        standing = None if self._standing is None else partial(self._standing, host, message)
        if given is None and standing is None:
            return await new_link()
        from lfield.operator.orders.racing import first_answer

        # An order is answered in one way.
        return cast("T", await first_answer(host, cast("Any", new_link), given, standing))

    @property
    def answered(self) -> Mapping[K, T | LfieldError]:
        """The answers that have come, without those of other users' hosts."""
        return {key: answer for key, answer in self._answers.items() if not _user(key)}

    async def believed_within(self, seconds: float) -> bool:
        """Wait for the answers of `believed` for so long at most; returns whether they are complete."""
        done, _ = await asyncio.wait([self._believed], timeout=seconds)
        for task in done:
            task.result()
        return bool(done)

    async def believed(self) -> dict[K, T | LfieldError]:
        """The answers of all that are there on nobody else's word."""
        await self._believed
        return {key: self._answers[key] for key in self._addresses if not _user(key)}

    async def others(self) -> dict[K, T | LfieldError]:
        """Those of all others, and an error for each that has not answered until now or the end."""
        if self._others:
            left = self._end - asyncio.get_running_loop().time()
            _, late = await asyncio.wait(self._others, timeout=max(0.0, left))
            for task in late:
                task.cancel()
            await asyncio.gather(*self._others, return_exceptions=True)
        return {key: self._answers.get(key, self._late(key)) for key in self._addresses if _user(key)}

    def _late(self, key: K) -> LfieldError:
        why = f"the runs of other users have not all answered within {self._request.bound:g} s"
        return AddressError(self._addresses[key], why)


def _host(key: Hashable) -> str:
    return key.host if isinstance(key, Place) else str(key)


def _run(key: Hashable) -> str:
    return key.run if isinstance(key, Place) else ""


def _user(key: Hashable) -> str:
    return key.user if isinstance(key, Place) else ""
