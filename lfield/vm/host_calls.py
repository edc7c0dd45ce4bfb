"""Host calls of programs: output, time, random numbers, find, portals and devices."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from itertools import islice

from msgspec import structs

from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import HELD_DEVICE, PROXY, DeviceCallRecord
from lfield.errors import ConstraintError, DeviceError
from lfield.vm import portal_calls
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.cancellation import Cancellation
from lfield.vm.deadlines import Deadlines
from lfield.vm.engine_interface import HostCall
from lfield.vm.host_interface import Pending
from lfield.vm.memory import layout
from lfield.vm.memory.block import HeapFull
from lfield.vm.memory.layout import CALLING, PARKED, PROXY_MEMBER, THREAD_STATE, WAITING
from lfield.vm.memory.threads import image_without_states, place_of
from lfield.vm.memory.word_codec import (
    bits_of_real,
    decode_value,
    encode_device_value,
    real_from_bits,
    real_text,
)
from lfield.vm.offer_objects import (
    OfferClasses,
    SearchIncomplete,
    UnknownRealisation,
    write_offers,
    write_teams,
)
from lfield.vm.reservations.held_reservations import HeldReservations
from lfield.vm.scheduler import Scheduler

#: Consecutive query-and-yield turns after which a thread counts as polling ...
POLLS_BEFORE_PARKING = 16
#: ... and the seconds until its next turn, so that waiting uses little CPU time.
POLL_INTERVAL = 0.005

Handler = Callable[[Agent, int, int, list[int]], None]


class HostCallDispatcher:
    """Dispatcher with one method per kind of host call; each completes the thread's group, now or later."""

    def __init__(
        self,
        scheduler: Scheduler,
        view: MachineTeam,
        rng: random.Random,
        cancelling: Cancellation,
        limits: Deadlines,
        held: HeldReservations,
        blocks: Mapping[str, Handler],
    ) -> None:
        self._scheduler, self._team, self._own_host, self._rng = scheduler, view.members, view.own_host, rng
        self._cancellation, self._deadlines, self._held_reservations = cancelling, limits, held
        self._has_reserves = scheduler.program.has_reserves
        self._shapes = OfferClasses(scheduler.program)
        kinds: dict[str, Handler] = {
            "pcall": self._pcall,
            "yield": self._yield,
            "sleep": self._sleep,
            "now": self._now,
            "lived": self._elapsed,
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
            row.code: kinds.get(row.name) or self._output(row.name)
            for row in BY_CODE.values()
            if row.leaves_engine
        }

    @cached_property
    def _by_type(self) -> Mapping[str, Mapping[str, int]]:
        """The numbers of the agents by type and id."""
        found: dict[str, dict[str, int]] = {}
        for member in self._team:
            found.setdefault(member.type, {})[member.id] = member.number
        return found

    def dispatch(self, agent: Agent, thread: int, leave: HostCall) -> None:
        """Execute a thread's host call, unless its limit has expired or its call is cancelled.

        The host call is repeated after a collection when the heap is full.
        """
        if agent.pending_cancels and self._cancellation.deliver_at_head(
            agent, thread, leave.op, leave.operand
        ):
            return
        if agent.overdue and self._deadlines.expire(agent):
            return
        if agent.poll_counts:
            self._note_poll(agent, thread, BY_CODE[leave.op].name)
        block = agent.block
        start = block.top
        try:
            self._by_code[leave.op](agent, thread, leave.operand, leave.words)
        except HeapFull as full:
            self._scheduler.collect_and_retry(agent, thread, block.missing_words(start, full))

    def _note_poll(self, agent: Agent, thread: int, name: str) -> None:
        """Any operation except queries and yields ends polling."""
        if name in ("now", "lived", "device", "offers", "explain", "teams"):
            agent.outward_pollers.add(thread)
        elif name not in ("yield", "agent", "host"):
            agent.poll_counts.pop(thread, None)

    # --- output ---------------------------------------------------------------------------------------

    def _output(self, name: str) -> Handler:
        verb, _, kind = name.partition("_")

        def output(agent: Agent, thread: int, operand: int, words: list[int]) -> None:
            text = _printed_text(agent, kind, words[0])
            if verb == "print":
                self._scheduler.world.log(agent, text)
            else:
                self._write(agent, thread, text)
            self._scheduler.complete_at_once(agent, thread)

        return output

    def _write(self, agent: Agent, thread: int, text: str) -> None:
        """Buffer text until its newline, so that lines of threads are not mixed."""
        output = agent.lines.pop(thread, "") + text
        end = output.rfind("\n") + 1
        if end:
            self._scheduler.world.write(agent, output[:end])
        if rest := output[end:]:
            agent.lines[thread] = rest

    # --- time and random numbers ----------------------------------------------------------------------

    def _yield(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        place = place_of(agent.block, thread)
        parks = scheduler.engine.groups[scheduler.instruction_of(agent, thread)].parks
        scheduler.engine.complete(agent.block, place, 0)
        scheduler.open(agent)
        if parks:
            scheduler.set_state(agent, thread, PARKED)
            return
        agent.poll_counts[thread] = polls = agent.poll_counts.get(thread, 0) + 1
        if polls <= POLLS_BEFORE_PARKING:
            scheduler.run_queue.push_back(agent, thread)
        else:
            self._poll(agent, thread)

    def _poll(self, agent: Agent, thread: int) -> None:
        """Park or delay a thread that only yields: `while (!done) yield();`.

        If its turn did not change the block, the next turn will not change it either until another thread of
        the agent runs: the thread is parked. If it read the clock or a device, its turns are delayed.
        """
        scheduler = self._scheduler
        agent.note_poll()
        image = image_without_states(agent.block)
        if image == agent.last_polled_image and thread not in agent.outward_pollers:
            scheduler.set_state(agent, thread, PARKED)
            agent.pollers.add(thread)
            return
        if image != agent.last_polled_image:
            scheduler.recheck_pollers(agent)
            agent.remember_poll(image)
        if thread in agent.outward_pollers:
            agent.outward_pollers.discard(thread)
            scheduler.run_queue.sleep(agent, thread, POLL_INTERVAL)
        else:
            scheduler.run_queue.push_back(agent, thread)

    def _sleep(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        scheduler.engine.complete(agent.block, place_of(agent.block, thread), 0)
        scheduler.open(agent)
        seconds = real_from_bits(words[0])
        # A thread does not sleep for NaN; a wait that is longer than any mission is unlimited.
        scheduler.run_queue.sleep(agent, thread, min(seconds, 1e9) if seconds > 0 else 0.0)

    def _now(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.complete_at_once(agent, thread, bits_of_real(self._scheduler.clock.time()))

    def _elapsed(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.complete_at_once(agent, thread, bits_of_real(self._lifetime(agent)))

    def _lifetime(self, agent: Agent) -> float:
        return self._scheduler.clock_of(agent) / 1e9

    def _limit(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        seconds = real_from_bits(words[0])
        if math.isnan(seconds):
            self._scheduler.throw_builtin(
                agent, thread, "ArithmeticException", "a time limit is not a number"
            )
            return
        self._scheduler.complete_at_once(agent, thread, self._deadlines.start_limit(agent, seconds))

    def _random(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.complete_at_once(agent, thread, bits_of_real(self._rng.random()))

    def _random_int(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if words[0] <= 0:
            self._scheduler.throw_builtin(
                agent, thread, "ArithmeticException", f"random({words[0]}) has no result"
            )
            return
        self._scheduler.complete_at_once(agent, thread, self._rng.randrange(words[0]))

    # --- the team -------------------------------------------------------------------------------------

    def _pcall(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        member = self._team[agent.block.w[words[0] + PROXY_MEMBER]]
        if member.host == self._own_host:
            number = self._held_reservations.reservation_number(agent, member) if self._has_reserves else 0
            portal_calls.call(self._scheduler, member, agent, thread, operand, words, number)
            return
        w = agent.block.w
        w[w[layout.W_THREADS] + THREAD_STATE] = CALLING
        agent.depart_for(member.id, operand)
        if self._scheduler.program.has_limits:
            self._deadlines.depart(agent, member, operand)
        else:
            self._scheduler.world.depart(agent, member)

    def _find(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        id = agent.block.string(words[0])
        name = scheduler.program.core.classes[operand].name
        of_type = self._by_type.get(name, {})
        number = of_type.get(id)
        if number is None:
            known = ", ".join(islice(of_type, 10)) or "none"
            message = f"the deployment has no {name} '{id}' (it has {known})"
            scheduler.throw_builtin(agent, thread, "UnknownResourceException", message, id)
            return
        scheduler.complete(agent, thread, lambda: _proxy(agent, operand, number))

    def _find_all(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        numbers = self._by_type.get(name, {}).values()
        proxy_type = next(
            i for i, t in enumerate(scheduler.program.core.types) if t.kind == PROXY and t.of == operand
        )
        core = scheduler.program.core
        kind = core.created_arrays()[proxy_type]

        def work() -> int:
            block = agent.block
            block.require(layout.GROWABLE_WORDS + 1 + len(numbers) * (1 + layout.PROXY_WORDS))
            array = block.new_array(kind, core.plain_array(kind), len(numbers))
            for i, number in enumerate(numbers, layout.elements(block.w, array)[0]):
                block.w[i] = _proxy(agent, operand, number)
            return array

        scheduler.complete(agent, thread, work)

    def _offers(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        constraint = agent.block.string(words[0]) if words[0] else None
        with self._search_errors(agent, thread, name):
            found = scheduler.world.offers(agent, name, constraint)
            now = self._lifetime(agent)
            scheduler.complete(
                agent, thread, lambda: write_offers(agent.block, self._shapes, operand, found, now)
            )

    def _teams(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        constraint = agent.block.string(words[0]) if words[0] else None
        with self._search_errors(agent, thread, name):
            found = scheduler.world.teams(agent, name, constraint, words[1])
            now = self._lifetime(agent)
            scheduler.complete(
                agent, thread, lambda: write_teams(agent.block, self._shapes, operand, found, now)
            )

    @contextmanager
    def _search_errors(self, agent: Agent, thread: int, capability: str) -> Iterator[None]:
        """Errors of a capability query, as L exceptions."""
        try:
            yield
        except (ConstraintError, UnknownRealisation) as error:
            self._scheduler.throw_builtin(agent, thread, "ConstraintException", str(error), capability)
        except SearchIncomplete as error:
            self._scheduler.throw_builtin(agent, thread, "LimitException", str(error), capability)

    def _explain(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        name = scheduler.program.core.classes[operand].name
        constraint = agent.block.string(words[0]) if words[0] else None
        try:
            text = scheduler.world.explain(agent, name, constraint)
        except ConstraintError as error:
            scheduler.throw_builtin(agent, thread, "ConstraintException", str(error), name)
            return
        scheduler.complete(agent, thread, lambda: agent.block.new_string(text))

    def _agent(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._complete_text(agent, thread, self._member_of(agent, words[0]).id)

    def _host(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._complete_text(agent, thread, self._scheduler.world.host_of(self._member_of(agent, words[0])))

    def _member_of(self, agent: Agent, proxy: int) -> TeamMember:
        return self._team[agent.block.w[proxy + PROXY_MEMBER]]

    def _complete_text(self, agent: Agent, thread: int, text: str) -> None:
        self._scheduler.complete(agent, thread, lambda: agent.block.new_string(text))

    def _device(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler = self._scheduler
        call = scheduler.program.core.device_calls[operand]
        if held := call.field == HELD_DEVICE:
            number, *words = words
            call = self._call_on_field(agent, call, number)
        if agent.loops is not None and call.effect != "query":
            kind, reason = agent.loops.refusal(thread)
            if kind:
                scheduler.throw_builtin(agent, thread, kind, f"{call.field}: {reason}", call.field)
                return
        values = [
            decode_value(agent.block, scheduler.program, kind, word)
            for kind, word in zip(call.parameters, words, strict=True)
        ]
        scheduler.set_state(agent, thread, WAITING)
        try:
            value = scheduler.world.call_device(agent, thread, call, values)
            if isinstance(value, Pending):
                return
            # Objects may be bound to different devices, so the device is determined at each call.
            agent.readings[operand] = None if held else scheduler.world.telemetry_reading(agent, call)
            scheduler.complete(
                agent,
                thread,
                lambda: encode_device_value(agent.block, scheduler.program, call.result, value, call.field),
                # A loop decides before the loops below it, whose ticks are at the same time.
                keeps_turn=agent.loops is not None and agent.loops.has(thread),
            )
        except DeviceError as error:
            scheduler.throw_builtin(
                agent, thread, error.kind, f"{error.device}: {error.reason}", error.device
            )

    def _call_on_field(self, agent: Agent, call: DeviceCallRecord, number: int) -> DeviceCallRecord:
        """A device call of an object, converted to a call of the resource's own field."""
        core = self._scheduler.program.core
        owner = self._scheduler.program.class_index[agent.member.type]
        device = core.classes[owner].devices[number - 1]
        assert device.type == call.device, "the compiler rejects other devices"
        return structs.replace(call, owner=owner, field=device.name)


def _proxy(agent: Agent, record: int, number: int) -> int:
    place = agent.block.allocate(layout.PROXY, record, layout.PROXY_WORDS)
    agent.block.w[place + layout.PROXY_MEMBER] = number
    return place


def _printed_text(agent: Agent, kind: str, word: int) -> str:
    """A value as `write` and `print` show it."""
    if kind == "str":
        return agent.block.string(word)
    if kind == "float":
        return real_text(real_from_bits(word))
    if kind == "bool":
        return "true" if word else "false"
    return str(word)
