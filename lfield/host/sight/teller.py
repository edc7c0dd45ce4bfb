"""What the parts of a host tell of it, and what of that led to what: the one way into its stream. Pure.

An event of an agent is caused by the last one of that agent here; that of a portal by the last one of the
call; that of a device by the instruction, or by whatever made it safe. Of what a program can do very often
each sort has a budget. Portal calls and instructions to devices are told only while it is `detailed`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from msgspec import Struct

from lfield.clock import Clock
from lfield.host.sight.budget import FILLED_EVERY, INSTRUCTIONS, PIECE, PORTALS, PRINTS, Allowance, Budget
from lfield.host.sight.stream import Stream
from lfield.wire import events
from lfield.wire.coordinators import Outcome
from lfield.wire.events import State
from lfield.wire.fields import MAX_LABEL, age, clip

#: What a device still does on its way to rest is told once in so many seconds.
ON_THE_WAY = 1.0


class _Call(Struct):
    """A portal call that is under way: who, whose, which; its last event, and when it began."""

    agent: str
    resource: str
    portal: str
    last: int
    up: float


class _Instruction(Struct):
    """An instruction to a device that is under way."""

    call: int
    agent: str
    device: str
    instruction: str
    portal: int
    number: int
    up: float


class Teller:
    """The stream of one life of a host, which begins now, and what is known of causes."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self._begun = clock, clock.monotonic()
        self.stream = Stream()
        #: Whether portal calls and instructions are told.
        self.detailed = False
        #: Called after every state.
        self.on_told: Callable[[], None] | None = None
        self._budgets: list[Budget] = []
        #: When they are to be filled up next, on the monotonic clock.
        self.due = 0.0
        self._portals, self._commands = self.budget(PORTALS), self.budget(INSTRUCTIONS)
        self._prints = self.budget(PRINTS)
        #: The last event of each agent, of each device, and of the link with each host.
        self._of_agent: dict[str, int] = {}
        self._of_device: dict[str, int] = {}
        self._of_host: dict[str, int] = {}
        #: What led to the safe states that devices go into for a reason.
        self._because: dict[str, int] = {}
        self._calls: dict[int, _Call] = {}
        self._instructions: dict[tuple[str, int], _Instruction] = {}
        self._asked = 0
        self._moved: dict[str, tuple[bool, float]] = {}
        self._refused: dict[str, bool] = {}

    @property
    def up(self) -> float:
        """For how many seconds the host is up, by its monotonic clock."""
        return self._clock.monotonic() - self._begun

    def event(self, what: State, cause: int = 0) -> int:
        """Something has happened; its number."""
        number = self.stream.tell(what, self._clock.time(), self.up, cause)
        if self.on_told is not None:
            self.on_told()
        return number

    def budget(self, watched: Allowance, unwatched: Allowance | None = None) -> Budget:
        """A new one, which is filled up with all others."""
        self._budgets.append(Budget(self.event, watched, unwatched))
        return self._budgets[-1]

    def detail(self, *, on: bool) -> None:
        """From now on more is told, since somebody watches; or no more."""
        self.detailed = on
        for budget in self._budgets:
            budget.watch(on=on)

    def fill(self, now: float) -> None:
        """Time has passed: more can be told again."""
        self.due = now + FILLED_EVERY
        for budget in self._budgets:
            budget.fill(now)

    def settle(self, *, at_once: bool = False) -> None:
        """Say how much was skipped, if it is time to, or `at_once`."""
        now = self.up
        for budget in self._budgets:
            budget.settle(now, at_once=at_once)

    def by(self, agent: str, what: State, cause: int | None = None) -> int:
        """An event of an agent, which its last one led to, or another one; its number."""
        cause = self._of_agent.get(agent, 0) if cause is None else cause
        number = self._of_agent[agent] = self.event(what, cause)
        return number

    # --- agents ---------------------------------------------------------------------------------------

    def started(self, agent: str, generation: int, *, kept: bool = False) -> None:
        """An agent runs here."""
        self.by(agent, events.Started(agent, generation, kept))

    def finished(self, agent: str, generation: int, how: Outcome, detail: str) -> None:
        """It has ended."""
        self.by(agent, events.Finished(agent, generation, how, clip(detail)))

    def printed(self, agent: str, text: str) -> None:
        """A line of `print`."""
        self._print(events.Printed(agent, clip(text)))

    def written(self, agent: str, text: str) -> None:
        """What `write` has put out."""
        self._print(events.Printed(agent, clip(text), "out"))

    def _print(self, what: events.Printed) -> None:
        if self._prints.take("printed", max(1.0, len(what.text) / PIECE)):
            self.by(what.agent, what)

    # --- portals, and instructions to devices ---------------------------------------------------------

    def began(self, call: int, agent: str, resource: str, portal: str) -> None:
        """A portal has begun; by `call` it is known until it ends."""
        if not self._portals.take("began"):
            return
        up = self.up
        portal = clip(portal, MAX_LABEL)
        number = self.by(agent, events.Began(call, agent, resource, portal))
        self._of_agent[resource] = number
        self._calls[call] = _Call(agent, resource, portal, number, up)

    def forget_calls(self) -> None:
        """The ends of those that are under way will not be told."""
        self._calls.clear()

    def is_told(self, call: int) -> bool:
        """Whether the beginning of a portal call that is under way was told."""
        return call in self._calls

    def ended(self, call: int, how: Literal["done", "thrown", "lost"], detail: str = "") -> None:
        """It has ended: nothing is told of one whose beginning was not."""
        known = self._calls.pop(call, None)
        if known is None:
            return
        seconds, detail = age(self.up - known.up), clip(detail)
        what = events.Ended(call, known.agent, known.resource, known.portal, seconds, how, detail)
        number = self.event(what, known.last)
        self._of_agent[known.agent] = self._of_agent[known.resource] = number

    def resource_died(self, resource: str, reason: str) -> None:
        """None of its portals goes on."""
        for call in [call for call, known in self._calls.items() if known.resource == resource]:
            self.ended(call, "lost", reason)

    def asked(self, agent: str, thread: int, portal: int, device: str, instruction: str) -> None:
        """A thread of an agent gives a device an instruction, for the portal call of that number, or 0."""
        if not self._commands.take("asked"):
            return
        up = self.up
        self._asked += 1
        device, instruction = clip(device, MAX_LABEL), clip(instruction, MAX_LABEL)
        known = self._calls.get(portal)
        cause = known.last if known is not None else self._of_agent.get(agent, 0)
        number = self.event(events.Asked(self._asked, agent, device, instruction), cause)
        asked = _Instruction(self._asked, agent, device, instruction, portal, number, up)
        self._instructions[agent, thread] = asked
        self._goes_on(asked, number)

    def answered(self, agent: str, thread: int, error: str) -> None:
        """The device has answered."""
        asked = self._instructions.pop((agent, thread), None)
        if asked is None:
            return
        seconds = age(self.up - asked.up)
        what = events.Answered(asked.call, agent, asked.device, asked.instruction, seconds, clip(error))
        self._goes_on(asked, self.event(what, asked.number))

    def _goes_on(self, asked: _Instruction, number: int) -> None:
        self._of_agent[asked.agent] = self._of_device[asked.device] = number
        if (known := self._calls.get(asked.portal)) is not None:
            known.last = number

    # --- devices --------------------------------------------------------------------------------------

    def because(self, reason: str, number: int) -> None:
        """What devices go safe for, for that reason, is caused by that event."""
        self._because = {**dict(list(self._because.items())[-63:]), clip(reason): number}

    def without_policy(self, reason: str, users: tuple[str, ...]) -> None:
        """Devices go safe for that reason, since none of these coordinators is heard of."""
        self.because(reason, max((self._of_agent.get(user, 0) for user in users), default=0))

    def device(self, what: events.Latched | events.Confirmed | events.Moving | events.Released) -> None:
        """A device goes into its safe state, is there, comes to rest, or is in use again."""
        cause = self._of_device.get(what.device, 0)
        match what:
            case events.Latched():
                self._moved.pop(what.device, None)
                cause = self._because.get(what.reason, 0)
            case events.Confirmed() if not cause:
                cause = self._because.get(what.reason, 0)
            case events.Moving() if not self._is_news(what):
                return
        self._of_device[what.device] = self.event(what, cause)

    def _is_news(self, what: events.Moving) -> bool:
        """Whether the way of a device to rest is told again."""
        moving, now = bool(what.moving), self.up
        before, at = self._moved.get(what.device, (None, 0.0))
        if moving is before and (not moving or now - at < ON_THE_WAY):
            return False
        self._moved[what.device] = moving, now
        return True

    # --- the team, and people -------------------------------------------------------------------------

    def linked(self, host: str, *, restarted: bool) -> None:
        """A host can be talked to."""
        self._of_host[host] = self.event(events.Linked(host, restarted))

    def unlinked(self, host: str, *, lost: bool) -> None:
        """A host cannot be talked to any more."""
        self._of_host[host] = self.event(events.Unlinked(host, lost))

    def offers(self, refusals: Mapping[str, str], hosts: Mapping[str, str]) -> None:
        """Why each agent of the team cannot be called, '' when it can; and on which host each is.

        What has changed since the last time is told.
        """
        for agent, refusal in refusals.items():
            before = self._refused.get(agent)
            self._refused[agent] = bool(refusal)
            if before is None or before is bool(refusal):
                continue
            cause = self._of_host.get(hosts.get(agent, ""), 0)
            what = events.Withdrawn(agent, clip(refusal)) if refusal else events.Offered(agent)
            self.event(what, cause or self._of_devices(agent))

    def _of_devices(self, agent: str) -> int:
        """The last event of any device of an agent."""
        return max((n for d, n in self._of_device.items() if d.startswith(f"{agent}.")), default=0)

    def refused(self, host: str, reason: str) -> None:
        """No link with a host can be made, for that reason; '' when that is over."""
        self.event(events.Refused(host, clip(reason)))

    def waits(self, agents: Sequence[str], hosts: Sequence[str], held: str) -> None:
        """Coordinators are not started yet, since their start waits; none waits any more without any."""
        self.event(events.Waits(clip(", ".join(agents)), clip(", ".join(hosts)), clip(held)))

    def stopped(self, by: str, reason: str, *, lifted: bool) -> None:
        """Somebody has pressed the emergency stop, or lifted it."""
        number = self.event(events.Stopped(clip(by), clip(reason), lifted))
        if not lifted:
            self.because(reason, number)

    def paused(self, by: str, reason: str, *, lifted: bool) -> None:
        """Somebody has paused the mission, or lets it go on; devices are held for that reason."""
        self.because(reason, self.event(events.Paused(clip(by), lifted)))

    def ending(self, why: str, reason: str) -> None:
        """The host ends; devices go safe for that reason."""
        self.because(reason, self.event(events.Ending(clip(why))))

    def logged(self, text: str) -> None:
        """A line of the log."""
        self.event(events.Logged(clip(text)))
