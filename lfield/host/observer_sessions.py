"""Serves the observers of a host: status, stop and pause orders, `forget`, `recover`, `start`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import cast

from lfield.authority.identity import Identity
from lfield.devices.device_guards import DeviceGuards
from lfield.errors import AddressError
from lfield.event_loop import spawn
from lfield.host.core import HostCore
from lfield.host.inputs import (
    ForgetOrdered,
    HostInput,
    LineEntered,
    PersonCallCancelled,
    PersonCalled,
    RecoveryOrdered,
    StartOrdered,
)
from lfield.host.stop_orders.order_executor import Dispatch, OrderExecutor
from lfield.host.subscriptions.subscription_server import SubscriptionServer
from lfield.net.link_manager import LinkManager
from lfield.net.transport import Link
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.fields import MAX_NAME, truncate
from lfield.wire.messages import Control
from lfield.wire.observer_messages import (
    BallotHold,
    EmergencyStop,
    ForgetRequest,
    ForgetResponse,
    InputLine,
    InputResult,
    Pause,
    RecoverRequest,
    RecoverResponse,
    StartRequest,
    StartResponse,
    Status,
)
from lfield.wire.person_calls.portal_call_messages import (
    PortalCallCancel,
    PortalCallRequest,
    PortalCallResult,
)
from lfield.wire.subscription_messages import EventAck, Subscribe

#: Seconds for which the answer to a start request waits for the reports of other hosts' vehicles.
START_TIMEOUT = 3.0
#: Seconds between two snapshots for observers that ask for one: requests in between share the next snapshot.
SNAPSHOT_INTERVAL = 0.05
#: The most links to which the result of one portal call is sent, and the most calls with such links.
MAX_ANSWERS, MAX_WAITING = 4, 1024
#: The seconds after a request for which an observer may be monitoring devices: it then gets one more answer
#: in time.
OBSERVED_WITHIN, LINGER = 3.0, 1.5


class ObserverSessions:
    """The observers of one host.

    `dispatch` passes an event to the core, which `status` describes; `flush` waits until all records are on
    disk, at most the given seconds, and returns whether they are.
    """

    def __init__(
        self,
        core: HostCore,
        guards: DeviceGuards,
        links: LinkManager,
        dispatch: Dispatch,
        status: Callable[[], Status],
        note: Callable[[LogLine], None],
        flush: Callable[[float | None], Awaitable[bool]],
    ) -> None:
        self._core, self._clock = core, guards.clock
        clock = self._clock
        self._dispatch, self._note, self._flush = dispatch, note, flush
        self.subscriptions = SubscriptionServer(core, guards, clock, status, links.monitor.latest)
        self.order_executor = OrderExecutor(core, guards, dispatch, note, flush)
        #: The time when the status of the devices was last requested.
        self._last_request = -OBSERVED_WITHIN
        #: The links that wait for a snapshot, with the whole directory or not; the time of the last snapshot.
        self._waiting: dict[Link, bool] = {}
        self._last_sent = -SNAPSHOT_INTERVAL
        #: The links that wait for the results of portal calls, by the id of the call.
        self._callers: dict[bytes, list[Link]] = {}

    def on_message(self, message: Control, link: Link) -> None:
        """A request of an observer. Messages between hosts are not answered."""
        match message:
            case Subscribe(once=True):
                self._send_snapshot(link, directory=message.directory)
            case Subscribe():
                self.subscriptions.subscribe(message, link)
            case EventAck():
                self.subscriptions.on_ack(message, link)
            case EmergencyStop() | Pause():
                self.order_executor.on_order(
                    message, str(link.identity), lambda answer: self._answer(link, answer)
                )
            case BallotHold():
                self.order_executor.on_ballot_hold(message, lambda answer: self._answer(link, answer))
            case ForgetRequest():
                spawn(self._answer_when_durable(link, ForgetOrdered(message.agent), _forget_response))
            case RecoverRequest():
                spawn(self._answer_when_durable(link, RecoveryOrdered(message), _recover_response))
            case InputLine():
                self._note(log_messages.INPUT_RECEIVED.line(operator=link.identity))
                entry = LineEntered(message.text, message.agent)
                self._dispatch(entry, lambda found: self._answer(link, InputResult(cast(str, found))))
            case StartRequest():
                spawn(self._start_coordinators(message, link))
            case PortalCallRequest():
                self._call_portal(message, link)
            case PortalCallCancel():
                self._cancel_call(message, link)

    def _send_snapshot(self, link: Link, *, directory: bool) -> None:
        """Send a snapshot, at most one per interval, so that requests cannot keep a host busy."""
        self._last_request = self._clock.monotonic()
        waits, self._waiting[link] = bool(self._waiting), directory
        remaining = self._last_sent + SNAPSHOT_INTERVAL - self._last_request
        if remaining <= 0:
            self._send_snapshot_to_all()
        elif not waits:
            asyncio.get_running_loop().call_later(remaining, self._send_snapshot_to_all)

    def _send_snapshot_to_all(self) -> None:
        self._last_sent = self._clock.monotonic()
        asking, self._waiting = self._waiting, {}
        if asking:
            batches = {
                directory: self.subscriptions.snapshot_batch(directory=directory)
                for directory in set(asking.values())
            }
            for link, directory in asking.items():
                self._answer(link, batches[directory])

    async def linger_for_observers(self) -> None:
        """After an emergency stop, keep answering observers so that they see its outcome."""
        if self._core.coordinators.stopped and self._clock.monotonic() - self._last_request < OBSERVED_WITHIN:
            await asyncio.sleep(LINGER)

    def _call_portal(self, message: PortalCallRequest, link: Link) -> None:
        """Start a portal call; `on_call_result` sends the answer, perhaps at once."""
        self._await_result(message.id, link)
        self._dispatch(PersonCalled(message, *_caller(link.identity, is_assistant=message.is_assistant)))

    def _cancel_call(self, message: PortalCallCancel, link: Link) -> None:
        """Cancel a call of this person, or of an assistant of this person."""
        self._await_result(message.id, link)
        for is_assistant in (False, True):
            caller = _caller(link.identity, is_assistant=is_assistant)
            self._dispatch(PersonCallCancelled(message.id, *caller))

    def _await_result(self, id: bytes, link: Link) -> None:
        waiting = self._callers.setdefault(id, [])
        if link not in waiting:
            waiting.append(link)
            # A client that repeats its call over new links has no use for answers over old ones.
            del waiting[:-MAX_ANSWERS]
            # Discard the ids of links that are never answered, such as a link that cancels the call of
            # another one.
            if len(self._callers) > MAX_WAITING:
                del self._callers[next(iter(self._callers))]

    def on_call_result(self, result: PortalCallResult) -> None:
        """A portal call has ended, or was refused."""
        for link in self._callers.pop(result.id, ()):
            self._answer(link, result)

    async def _start_coordinators(self, message: StartRequest, link: Link) -> None:
        """Start the waiting coordinators; answer when they have started, or with the conditions that they
        still wait for.
        """
        startup = self._core.startup
        answers: list[StartResponse] = []
        self._note(log_messages.START_REQUESTED.line(operator=link.identity))
        self._dispatch(
            StartOrdered(list(message.without)), lambda found: answers.append(cast(StartResponse, found))
        )
        until = self._clock.monotonic() + START_TIMEOUT
        while startup.is_settling and self._clock.monotonic() < until:
            await asyncio.sleep(SNAPSHOT_INTERVAL)
        if await self._flush(None) and answers:
            waiting = startup.status
            started = [] if waiting is not None or answers[0].trouble else answers[0].started
            self._answer(link, StartResponse(started, waiting, answers[0].trouble))

    async def _answer_when_durable(
        self, link: Link, entry: HostInput, response: Callable[[object], Control]
    ) -> None:
        """Answer when the changes of an operator's request are on disk, not earlier."""
        answers: list[Control] = []
        self._dispatch(entry, lambda found: answers.append(response(found)))
        if await self._flush(None) and answers:
            self._answer(link, answers[0])

    def _answer(self, link: Link, message: Control) -> None:
        # The observer may have closed its link, or be out of radio range.
        with suppress(AddressError):
            link.send(message)


def _caller(identity: Identity, *, is_assistant: bool = False) -> tuple[str, str]:
    """The name of a person, '' for a user of this computer; and the name of the caller in events and log
    lines.
    """
    name = identity.name if identity.kind == "person" else ""
    name_text = f"person {identity.name}" if identity.kind == "person" else f"user {identity.name}"
    label = f"assistant of {name_text}" if is_assistant else name_text
    return name, truncate(label, MAX_NAME)


def _forget_response(found: object) -> Control:
    return ForgetResponse(cast(list[int], found))


def _recover_response(found: object) -> Control:
    return cast(RecoverResponse, found)
