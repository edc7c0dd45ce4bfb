"""A person at a computer beside a simulated team, who gives the orders that the commands give.

Orders are sent by the code of `lfield estop`, `pause`, `resume`, `recover` and `forget`, over links of their
own. What is held (a stop, a pause) is taken back after a while, and at the end whatever the hosts still hold.
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
from lfield.loop import spawn
from lfield.net.tcp import TcpTransport
from lfield.operator.addressed import Place
from lfield.operator.ask import STATUS, ask_all, emergency_stop, forget, pause, recover
from lfield.operator.observing import Request, ask
from lfield.operator.recover import believed
from lfield.operator.whereabouts import insist_on_doubt, records
from lfield.simulate.fleet import Fleet
from lfield.simulate.network import resident
from lfield.wire.observing import EmergencyStopped, StartRequest, StartResponse, Status

#: What holds until it is taken back.
Hold = Literal["stop", "pause"]
REASON = "pressed in a simulation"
#: A set of tasks in the order of their begin: that of a set depends on addresses in memory.
Tasks = dict[asyncio.Task[None], None]

_Answers = Mapping[Place, Status | LfieldError]


class Judges(Protocol):
    """Whoever checks what the answers promise."""

    def confirmed(self, hold: Hold, host: str, answer: EmergencyStopped) -> None:
        """A host has answered that it is stopped, or paused."""

    def lifting(self, hold: Hold) -> None:
        """From now on a host may hear that this is over."""

    def gave_up(self, agent: str, starts: Mapping[str, int]) -> None:
        """These hosts have given up a coordinator, up to these starts."""

    def acts(self) -> None:
        """A host is gone, and the person recovers its coordinators from copies, or gives them up."""


class Operator:
    """The person. `judges` hears what hosts have answered, and that an order ends before any host does."""

    def __init__(self, fleet: Fleet, judges: Judges, dice: random.Random) -> None:
        self._fleet, self._judges = fleet, judges
        seed = dice.random()
        self._process = fleet.station("operator", random.Random(seed))
        #: For the ids of orders.
        self._dice = random.Random(f"ids {seed}")
        self._transport = TcpTransport(fleet.mission.max_block, resident=resident)
        self._places = {Place("", host): address for host, address in fleet.mission.team.reached.items()}
        self._names = {place: place.host for place in self._places}
        #: Until when the buttons of a kind are held, in true time; and how often each was pressed.
        self._held: dict[Hold, float] = {}
        self.presses: Counter[Hold] = Counter()
        #: What gives an order of a kind, and what takes one back, until every host has answered. A person
        #: does one of the two at a time.
        self._pressing: defaultdict[Hold, Tasks] = defaultdict(dict)
        self._lifting: defaultdict[Hold, Tasks] = defaultdict(dict)
        #: What is to be done with coordinators whose host is gone for good.
        self._orphans: dict[str, Callable[[str, _Answers], Awaitable[bool]]] = {}
        self._looks = self._starts = False
        #: How many orders of a kind hosts have carried out.
        self.carried_out: Counter[str] = Counter()

    def _begin(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._process.loop.enter(lambda: spawn(work()))

    # --- stop and pause -------------------------------------------------------------------------------

    def press(self, hold: Hold, seconds: float) -> None:
        """Stop or pause the team, and take that back after so many seconds."""
        self._interrupt(self._lifting.pop(hold, {}))
        self.presses[hold] += 1
        self._held[hold] = max(self._held.get(hold, 0.0), self._fleet.now + seconds)
        self._fleet.later(seconds, partial(self._let_go, hold))
        for place in self._places:
            self._begin(partial(self._order, hold, place))

    def _interrupt(self, tasks: Tasks) -> None:
        """As by Ctrl-C: what is on its way already may come later."""
        for task in list(tasks):
            self._process.loop.enter(task.cancel)

    async def _order(self, hold: Hold, place: Place) -> None:
        press = self.presses[hold]
        with _listed(self._pressing[hold]):
            answer = await self._ask(place, self._request(hold, lift=False))
        # An answer that comes when the button is let go promises nothing any more.
        if isinstance(answer, EmergencyStopped) and hold in self._held and press == self.presses[hold]:
            self.carried_out[hold] += 1
            self._judges.confirmed(hold, place.host, answer)

    def _request(self, hold: Hold, *, lift: bool) -> Request[EmergencyStopped]:
        draw = self._dice.randbytes
        return emergency_stop(REASON, lift=lift, draw=draw) if hold == "stop" else pause(lift=lift, draw=draw)

    async def _ask(self, place: Place, request: Request[Any]) -> Any:
        try:
            return await ask(self._transport, self._places[place], request, place.host)
        except LfieldError as error:
            return error

    def _let_go(self, hold: Hold) -> None:
        if self._held.get(hold, self._fleet.now + 1.0) <= self._fleet.now:
            del self._held[hold]
            self._judges.lifting(hold)
            self._begin(partial(self._lift, hold))

    async def _lift(self, hold: Hold) -> None:
        self._interrupt(self._pressing.pop(hold, {}))
        with _listed(self._lifting[hold]):
            await ask_all(self._transport, self._places, self._request(hold, lift=True))
        if hold == "stop":
            await self._start()

    async def _start(self) -> None:
        """As `lfield start --without` the hosts that are gone: what was not started during a stop."""
        request = Request(StartRequest(sorted(self._fleet.gone)), StartResponse, 8.0, again=True)
        self._starts = True
        try:
            await ask_all(self._transport, self._places, request)
        finally:
            self._starts = False

    # --- coordinators of hosts that are gone ----------------------------------------------------------

    def lose(self, *, recovers: bool) -> None:
        """A host is gone for good: go on with each coordinator that went there, or else give it up."""
        go = self._recover if recovers else self._forget
        self._judges.acts()
        self._orphans = {member.id: go for member in self._fleet.mission.team.coordinators}
        self.look_after()

    def look_after(self) -> None:
        """Try what could not be done so far."""
        if self._orphans and not self._looks:
            self._looks = True
            self._begin(self._look)

    async def _look(self) -> None:
        try:
            answers = await ask_all(self._transport, self._places, STATUS)
            for agent, go in list(self._orphans.items()):
                if self._was_lost(agent, answers) and await go(agent, answers):
                    del self._orphans[agent]
        finally:
            self._looks = False

    def _was_lost(self, agent: str, answers: _Answers) -> bool:
        """Whether the newest that anybody knows of a coordinator is that it went to a host that is gone."""
        silent = {place.host for place, answer in answers.items() if not isinstance(answer, Status)}
        known = [known for _, known in records(agent, answers)]
        newest = max(known, key=lambda known: (known.generation, known.hops, known.sequence), default=None)
        return silent <= self._fleet.gone and newest is not None and newest.where in self._fleet.gone

    async def _recover(self, agent: str, answers: _Answers) -> bool:
        """As `lfield recover`."""
        try:
            belief = believed(agent, answers, self._names)
        except (CoordinatorAlive, UsageError):
            return False
        answer = await self._ask(belief.place, recover(belief.word))
        done = not isinstance(answer, LfieldError) and bool(answer.generation)
        self.carried_out["recover"] += done
        return done

    async def _forget(self, agent: str, answers: _Answers) -> bool:
        """As `lfield forget`."""
        try:
            insist_on_doubt(agent, answers, self._names)
        except (CoordinatorAlive, UsageError):
            return False
        told = await ask_all(self._transport, self._places, forget(agent))
        starts = {
            place.host: max(answer.starts)
            for place, answer in told.items()
            if not isinstance(answer, LfieldError) and answer.starts
        }
        if starts:
            self.carried_out["forget"] += 1
            self._judges.gave_up(agent, starts)
        return bool(starts)

    # --- the end --------------------------------------------------------------------------------------

    def free_all(self) -> None:
        """Take back all that may hold; to be repeated, since an order may still be on its way to a host."""
        for hold in list(self._held):
            del self._held[hold]
            self._judges.lifting(hold)
        self.look_after()
        for hold in self.presses:
            self._begin(partial(self._lift, hold))
        if self._fleet.gone and not self._starts:
            self._begin(self._start)


@contextmanager
def _listed(tasks: Tasks) -> Iterator[None]:
    """The task that runs now is one of these meanwhile."""
    task = asyncio.current_task()
    assert task is not None
    tasks[task] = None
    try:
        yield
    finally:
        tasks.pop(task, None)
