"""Heads that leave the engine: output, time, chance, find, portals and devices."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice

from msgspec import structs

from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import ARRAY, HELD, PROXY, DeviceCall
from lfield.errors import ConstraintError, DeviceError
from lfield.vm import portals
from lfield.vm.agent import Agent, Member
from lfield.vm.cancelling import Cancelling
from lfield.vm.contract import Outside
from lfield.vm.limits import TimeLimits
from lfield.vm.memory import layout
from lfield.vm.memory.block import Full
from lfield.vm.memory.layout import PARKED, PROXY_MEMBER, WAITING
from lfield.vm.memory.threads import place_of, still_image
from lfield.vm.memory.values import plain, real_of, real_text, word_for, word_of
from lfield.vm.offers import SearchGivenUp, Shapes, UnknownWay, write_offers, write_teams
from lfield.vm.reserve.held import Held
from lfield.vm.scheduler import Scheduler
from lfield.vm.world import Pending

#: A thread that does nothing but ask and yield, so often in a row, is polling ...
POLLS = 16
#: ... and gets its turn again after so many seconds, so that waiting costs next to nothing.
POLL_INTERVAL = 0.005

Handler = Callable[[Agent, int, int, list[int]], None]


class Outsiders:
    """One method per kind of head; each ends by completing the thread's group, now or later."""

    def __init__(
        self,
        scheduler: Scheduler,
        team: Sequence[Member],
        here: int,
        dice: random.Random,
        cancelling: Cancelling,
        limits: TimeLimits,
        held: Held,
        blocks: Mapping[str, Handler],
    ) -> None:
        self._scheduler, self._team, self._here, self._dice = scheduler, team, here, dice
        self._cancelling, self._limits, self._held = cancelling, limits, held
        self._reserves = scheduler.program.has_reserves
        self._shapes = Shapes(scheduler.program)
        self._by_type: dict[str, dict[str, int]] = {}
        for member in team:
            self._by_type.setdefault(member.type, {})[member.id] = member.number
        kinds: dict[str, Handler] = {
            "pcall": self._pcall,
            "yield": self._yield,
            "sleep": self._sleep,
            "now": self._now,
            "lived": self._lived,
            "random": self._random,
            "random_int": self._random_int,
            "find": self._find,
            "findall": self._find_all,
            "offers": self._offers,
            "explain": self._explain,
            "teams": self._teams,
            "agent": self._agent,
            "host": self._host,
            "device": self._device,
            "limit": self._limit,
            **blocks,
        }
        self._by_code: dict[int, Handler] = {
            row.code: kinds.get(row.name) or self._output(row.name) for row in BY_CODE.values() if row.exits
        }

    def carry_out(self, agent: Agent, thread: int, leave: Outside) -> None:
        """Do what a thread asked for, unless its time is over or its call is cancelled.

        What lacks room is done again when there is.
        """
        if agent.cancels and self._cancelling.waits(agent, thread, leave.op, leave.operand):
            return
        if agent.overdue and self._limits.strike(agent):
            return
        if agent.polls:
            self._note_poll(agent, thread, BY_CODE[leave.op].name)
        block = agent.block
        start = block.top
        try:
            self._by_code[leave.op](agent, thread, leave.operand, leave.words)
        except Full as full:
            self._scheduler.make_room(agent, thread, block.lacking(start, full))

    def _note_poll(self, agent: Agent, thread: int, name: str) -> None:
        """Anything but asking and yielding shows that a thread does more than poll."""
        if name in ("now", "lived", "device", "offers", "explain", "teams"):
            agent.asked.add(thread)
        elif name not in ("yield", "agent", "host"):
            agent.polls.pop(thread, None)

    # --- output ---------------------------------------------------------------------------------------

    def _output(self, name: str) -> Handler:
        verb, _, kind = name.partition("_")

        def output(agent: Agent, thread: int, operand: int, words: list[int]) -> None:
            text = _shown(agent, kind, words[0])
            if verb == "print":
                self._scheduler.world.log(agent, text)
            else:
                self._write(agent, thread, text)
            self._scheduler.go_on(agent, thread)

        return output

    def _write(self, agent: Agent, thread: int, text: str) -> None:
        """Keep text until its newline, so that lines of several threads are never torn."""
        whole = agent.lines.pop(thread, "") + text
        end = whole.rfind("\n") + 1
        if end:
            self._scheduler.world.write(agent, whole[:end])
        if rest := whole[end:]:
            agent.lines[thread] = rest

    # --- time and chance ------------------------------------------------------------------------------

    def _yield(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        place = place_of(agent.block, thread)
        parks = scheduler.engine.groups[scheduler.standing(agent, thread)].parks
        scheduler.engine.complete(agent.block, place, 0)
        scheduler.open(agent)
        if parks:
            scheduler.set_state(agent, thread, PARKED)
            return
        agent.polls[thread] = polls = agent.polls.get(thread, 0) + 1
        if polls <= POLLS:
            scheduler.turns.last(agent, thread)
        else:
            self._poll(agent, thread)

    def _poll(self, agent: Agent, thread: int) -> None:
        """A thread that only yields: `while (!done) yield();`.

        If its turn has changed nothing in its block, the next one will not either, until another thread of
        the agent has run: it is parked till then. If it asked the clock or a device, which may answer
        differently each time, it gets its turn by and by.
        """
        scheduler = self._scheduler
        agent.polled = True
        image = still_image(agent.block)
        if image == agent.seen and thread not in agent.asked:
            scheduler.set_state(agent, thread, PARKED)
            agent.pollers.add(thread)
            return
        if image != agent.seen:
            scheduler.stir(agent)
            agent.seen = image
        if thread in agent.asked:
            agent.asked.discard(thread)
            scheduler.turns.sleep(agent, thread, POLL_INTERVAL)
        else:
            scheduler.turns.last(agent, thread)

    def _sleep(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        scheduler.engine.complete(agent.block, place_of(agent.block, thread), 0)
        scheduler.open(agent)
        seconds = real_of(words[0])
        # Not a number sleeps not at all; a wait beyond any mission is as good as for ever.
        scheduler.turns.sleep(agent, thread, min(seconds, 1e9) if seconds > 0 else 0.0)

    def _now(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.go_on(agent, thread, word_of(self._scheduler.clock.time()))

    def _lived(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.go_on(agent, thread, word_of(self._lifetime(agent)))

    def _lifetime(self, agent: Agent) -> float:
        return self._scheduler.clock_of(agent) / 1e9

    def _limit(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        seconds = real_of(words[0])
        if math.isnan(seconds):
            self._scheduler.refuse(agent, thread, "ArithmeticException", "a time limit is not a number")
            return
        self._scheduler.go_on(agent, thread, self._limits.end(agent, seconds))

    def _random(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.go_on(agent, thread, word_of(self._dice.random()))

    def _random_int(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if words[0] <= 0:
            self._scheduler.refuse(agent, thread, "ArithmeticException", f"random({words[0]}) has no result")
            return
        self._scheduler.go_on(agent, thread, self._dice.randrange(words[0]))

    # --- the team -------------------------------------------------------------------------------------

    def _pcall(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        member = self._team[agent.block.w[words[0] + PROXY_MEMBER]]
        if member.host == self._here:
            number = self._held.number(agent, member) if self._reserves else 0
            portals.call(self._scheduler, member, agent, thread, operand, words, number)
            return
        self._scheduler.freeze(agent, thread)
        self._limits.depart(agent, member)

    def _find(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        wanted = agent.block.string(words[0])
        name = scheduler.program.core.classes[operand].name
        of_type = self._by_type.get(name, {})
        number = of_type.get(wanted)
        if number is None:
            known = ", ".join(islice(of_type, 10)) or "none"
            message = f"the deployment has no {name} '{wanted}' (it has {known})"
            scheduler.refuse(agent, thread, "UnknownResourceException", message, wanted)
            return
        scheduler.complete(agent, thread, lambda: _proxy(agent, operand, number))

    def _find_all(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        numbers = self._by_type.get(name, {}).values()
        of = next(
            i for i, t in enumerate(scheduler.program.core.types) if t.kind == PROXY and t.of == operand
        )
        kind = next(i for i, t in enumerate(scheduler.program.core.types) if t.kind == ARRAY and t.of == of)

        def work() -> int:
            block = agent.block
            block.require(1 + len(numbers) * (1 + layout.PROXY_WORDS))
            array = block.allocate(layout.ARRAY, kind, 1 + len(numbers))
            for i, number in enumerate(numbers, array + 1):
                block.w[i] = _proxy(agent, operand, number)
            return array

        scheduler.complete(agent, thread, work)

    def _offers(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        constraint = agent.block.string(words[0]) if words[0] else None
        with self._refused(agent, thread, name):
            found = scheduler.world.offers(agent, name, constraint)
            now = self._lifetime(agent)
            scheduler.complete(
                agent, thread, lambda: write_offers(agent.block, self._shapes, operand, found, now)
            )

    def _teams(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        constraint = agent.block.string(words[0]) if words[0] else None
        with self._refused(agent, thread, name):
            found = scheduler.world.teams(agent, name, constraint, words[1])
            now = self._lifetime(agent)
            scheduler.complete(
                agent, thread, lambda: write_teams(agent.block, self._shapes, operand, found, now)
            )

    @contextmanager
    def _refused(self, agent: Agent, thread: int, capability: str) -> Iterator[None]:
        """What a question can go wrong with, as exceptions of L."""
        try:
            yield
        except (ConstraintError, UnknownWay) as error:
            self._scheduler.refuse(agent, thread, "ConstraintException", str(error), capability)
        except SearchGivenUp as error:
            self._scheduler.refuse(agent, thread, "LimitException", str(error), capability)

    def _explain(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        constraint = agent.block.string(words[0]) if words[0] else None
        try:
            text = scheduler.world.explain(agent, name, constraint)
        except ConstraintError as error:
            scheduler.refuse(agent, thread, "ConstraintException", str(error), name)
            return
        scheduler.complete(agent, thread, lambda: agent.block.new_string(text))

    def _agent(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._tell(agent, thread, self._behind(agent, words[0]).id)

    def _host(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._tell(agent, thread, self._scheduler.world.host_of(self._behind(agent, words[0])))

    def _behind(self, agent: Agent, proxy: int) -> Member:
        return self._team[agent.block.w[proxy + PROXY_MEMBER]]

    def _tell(self, agent: Agent, thread: int, text: str) -> None:
        self._scheduler.complete(agent, thread, lambda: agent.block.new_string(text))

    def _device(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        call = scheduler.program.core.device_calls[operand]
        if held := call.field == HELD:
            number, *words = words
            call = self._on(agent, call, number)
        values = [
            plain(agent.block, scheduler.program, kind, word)
            for kind, word in zip(call.parameters, words, strict=True)
        ]
        scheduler.set_state(agent, thread, WAITING)
        try:
            value = scheduler.world.device(agent, thread, call, values)
            if isinstance(value, Pending):
                return
            # Objects may have been given different devices: each time it is asked which one.
            agent.readings[operand] = None if held else scheduler.world.reading(agent, call)
            scheduler.complete(
                agent,
                thread,
                lambda: word_for(agent.block, scheduler.program, call.result, value, call.field),
            )
        except DeviceError as error:
            scheduler.refuse(agent, thread, error.kind, f"{error.device}: {error.reason}", error.device)

    def _on(self, agent: Agent, call: DeviceCall, number: int) -> DeviceCall:
        """The call of a device that an object was given, as one of the resource's own field."""
        core = self._scheduler.program.core
        owner = self._scheduler.program.class_index[agent.member.type]
        device = core.classes[owner].devices[number - 1]
        assert device.type == call.device, "the compiler lets no other device in"
        return structs.replace(call, owner=owner, field=device.name)


def _proxy(agent: Agent, record: int, number: int) -> int:
    place = agent.block.allocate(layout.PROXY, record, layout.PROXY_WORDS)
    agent.block.w[place + layout.PROXY_MEMBER] = number
    return place


def _shown(agent: Agent, kind: str, word: int) -> str:
    """A value as `write` and `print` show it."""
    if kind == "str":
        return agent.block.string(word)
    if kind == "float":
        return real_text(real_of(word))
    if kind == "bool":
        return "true" if word else "false"
    return str(word)
