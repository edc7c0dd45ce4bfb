"""An operator of a simulated team who gives the orders of the commands.

Orders are sent by the code of `lfield estop`, `pause`, `resume`, `recover` and `forget`, over separate
links. A hold (a stop, a pause) is lifted after a delay. At the end all remaining holds are lifted.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal, Protocol

from lfield.errors import CoordinatorAlive, LfieldError, UsageError
from lfield.event_loop import spawn
from lfield.net.tcp_transport import TcpTransport
from lfield.operator.client import SNAPSHOT, ask_all, emergency_stop, forget, pause, recover
from lfield.operator.coordinator_location import records, require_in_doubt
from lfield.operator.observer_link import Request, send_request
from lfield.operator.recovery_candidates import best_candidate
from lfield.operator.targets import HostRef
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_state import HostState
from lfield.simulate.host_fleet import Fleet, host_at_address
from lfield.wire.observer_messages import EmergencyStopResult, StartRequest, StartResponse

#: The orders that hold until they are lifted.
Hold = Literal["stop", "pause"]
REASON = "pressed in a simulation"
#: A set of tasks in the order of their start: that of a set depends on addresses in memory.
Tasks = dict[asyncio.Task[None], None]

_Hosts = Mapping[HostRef, HostState]


class AnswerChecks(Protocol):
    """The checks of answers."""

    def on_confirmed(self, hold: Hold, host: str, answer: EmergencyStopResult) -> None:
        """A host has confirmed that it is stopped, or paused."""

    def on_lifting(self, hold: Hold) -> None:
        """From now on a host may receive the end of the hold."""

    def on_given_up(self, agent: str, starts: Mapping[str, int]) -> None:
        """These hosts have confirmed the loss of a coordinator, up to these starts."""

    def on_recovery_by_operator(self) -> None:
        """A host is lost, and the operator recovers its coordinators from copies, or declares them lost."""


class SimulatedOperator:
    """The operator. `checks` receives the answers of hosts, and the end of an order before any host does."""

    def __init__(self, fleet: Fleet, checks: AnswerChecks, rng: random.Random) -> None:
        self._fleet, self._checks = fleet, checks
        seed = rng.random()
        self._process = fleet.add_station("operator", random.Random(seed))
        #: For the ids of orders.
        self._rng = random.Random(f"ids {seed}")
        self._transport = TcpTransport(fleet.mission.max_block, identify=host_at_address)
        self._places = {
            HostRef("", host): address for host, address in fleet.mission.team.addresses_by_host.items()
        }
        self._names = {place: place.host for place in self._places}
        #: The true time until which the buttons of a kind are held, and the number of presses of each.
        self._held: dict[Hold, float] = {}
        self.presses: Counter[Hold] = Counter()
        #: The task that gives an order of a kind, and the task that lifts one, until every host has answered.
        #: Only one of the two runs at a time.
        self._pressing: defaultdict[Hold, Tasks] = defaultdict(dict)
        self._lifting: defaultdict[Hold, Tasks] = defaultdict(dict)
        #: The pending actions for coordinators of lost hosts.
        self._orphans: dict[str, Callable[[str, _Hosts], Awaitable[bool]]] = {}
        self._retries = self._starts = False
        #: The number of executed orders of a kind.
        self.carried_out: Counter[str] = Counter()

    def _start_task(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._process.loop.enter(lambda: spawn(work()))

    # --- stop and pause -------------------------------------------------------------------------------

    def press(self, hold: Hold, seconds: float) -> None:
        """Stop or pause the team, and lift that after a number of seconds."""
        self._interrupt(self._lifting.pop(hold, {}))
        self.presses[hold] += 1
        self._held[hold] = max(self._held.get(hold, 0.0), self._fleet.now + seconds)
        self._fleet.later(seconds, partial(self._release, hold))
        for place in self._places:
            self._start_task(partial(self._order, hold, place))

    def _interrupt(self, tasks: Tasks) -> None:
        """Interrupt as by Ctrl-C: messages in flight may arrive later."""
        for task in list(tasks):
            self._process.loop.enter(task.cancel)

    async def _order(self, hold: Hold, place: HostRef) -> None:
        press = self.presses[hold]
        with _registered(self._pressing[hold]):
            answer = await self._ask(place, self._request(hold, lift=False))
        # An answer after the release of the button is no promise.
        if isinstance(answer, EmergencyStopResult) and hold in self._held and press == self.presses[hold]:
            self.carried_out[hold] += 1
            self._checks.on_confirmed(hold, place.host, answer)

    def _request(self, hold: Hold, *, lift: bool) -> Request[EmergencyStopResult]:
        draw = self._rng.randbytes
        return emergency_stop(REASON, lift=lift, draw=draw) if hold == "stop" else pause(lift=lift, draw=draw)

    async def _ask(self, place: HostRef, request: Request[Any]) -> Any:
        try:
            return await send_request(self._transport, self._places[place], request, place.host)
        except LfieldError as error:
            return error

    def _release(self, hold: Hold) -> None:
        if self._held.get(hold, self._fleet.now + 1.0) <= self._fleet.now:
            del self._held[hold]
            self._checks.on_lifting(hold)
            self._start_task(partial(self._lift, hold))

    async def _lift(self, hold: Hold) -> None:
        for task in list(self._pressing.pop(hold, {})):
            task.cancel()
        with _registered(self._lifting[hold]):
            await ask_all(self._transport, self._places, self._request(hold, lift=True))
        if hold == "stop":
            await self._start()

    async def _start(self) -> None:
        """Start like `lfield start --without` the lost hosts: coordinators that were not started during a
        stop."""
        request = Request(StartRequest(sorted(self._fleet.lost_hosts)), StartResponse, 8.0, is_retried=True)
        self._starts = True
        try:
            await ask_all(self._transport, self._places, request)
        finally:
            self._starts = False

    # --- coordinators of lost hosts -------------------------------------------------------------------

    def lose(self, *, recovers: bool) -> None:
        """Handle a permanently lost host: recover each of its coordinators, or declare it lost."""
        go = self._recover if recovers else self._forget
        self._checks.on_recovery_by_operator()
        self._orphans = {member.id: go for member in self._fleet.mission.team.coordinators}
        self.retry_orphans()

    def retry_orphans(self) -> None:
        """Retry the actions that were not possible so far."""
        if self._orphans and not self._retries:
            self._retries = True
            self._start_task(self._retry)

    async def _retry(self) -> None:
        try:
            hosts = host_states(await ask_all(self._transport, self._places, SNAPSHOT))
            for agent, go in list(self._orphans.items()):
                done = self._was_lost(agent, hosts) and await go(agent, hosts)
                # A recovered coordinator may hop to that host again before its link times out.
                if done and go != self._recover:
                    del self._orphans[agent]
        finally:
            self._retries = False

    def _was_lost(self, agent: str, hosts: _Hosts) -> bool:
        """True if the newest known state of a coordinator is a departure to a lost host."""
        silent = {place.host for place, host in hosts.items() if not host.linked}
        known = [known for _, known in records(agent, hosts)]
        newest = max(known, key=lambda known: (known.generation, known.hops, known.sequence), default=None)
        lost = self._fleet.lost_hosts
        return silent <= lost and newest is not None and newest.where in lost

    async def _recover(self, agent: str, hosts: _Hosts) -> bool:
        """Recover like `lfield recover`."""
        try:
            estimate = best_candidate(agent, hosts, self._names)
        except (CoordinatorAlive, UsageError):
            return False
        answer = await self._ask(estimate.host_ref, recover(estimate.request))
        done = not isinstance(answer, LfieldError) and bool(answer.generation)
        self.carried_out["recover"] += done
        return done

    async def _forget(self, agent: str, hosts: _Hosts) -> bool:
        """Declare lost like `lfield forget`."""
        try:
            require_in_doubt(agent, hosts, self._names)
        except (CoordinatorAlive, UsageError):
            return False
        answers = await ask_all(self._transport, self._places, forget(agent))
        starts = {
            place.host: max(answer.starts)
            for place, answer in answers.items()
            if not isinstance(answer, LfieldError) and answer.starts
        }
        if starts:
            self.carried_out["forget"] += 1
            self._checks.on_given_up(agent, starts)
        return bool(starts)

    # --- the end --------------------------------------------------------------------------------------

    def free_all(self) -> None:
        """Lift all holds; to be repeated, since an order may still be in flight to a host."""
        for hold in list(self._held):
            del self._held[hold]
            self._checks.on_lifting(hold)
        self.retry_orphans()
        for hold in self.presses:
            self._start_task(partial(self._lift, hold))
        if self._fleet.lost_hosts and not self._starts:
            self._start_task(self._start)


@contextmanager
def _registered(tasks: Tasks) -> Iterator[None]:
    """Keep the current task in `tasks` within this context."""
    task = asyncio.current_task()
    assert task is not None
    tasks[task] = None
    try:
        yield
    finally:
        tasks.pop(task, None)
