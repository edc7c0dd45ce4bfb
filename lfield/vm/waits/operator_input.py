"""Operator input of one host: the lines that were entered, and the threads that wait for a line in `read`.

A line goes to the thread that has waited longest. Without a waiting thread a few lines are kept for the next
ones, since the operator or a pipe may be faster than the program. Lines are not stored: a restart of the host
ends the portals that read them.
"""

from __future__ import annotations

import math
from collections import deque
from functools import partial
from typing import TYPE_CHECKING

from msgspec import Struct

from lfield.vm.agent import Agent
from lfield.vm.memory.layout import WAITING
from lfield.vm.memory.threads import place_of
from lfield.vm.memory.word_codec import real_from_bits
from lfield.vm.scheduler import Scheduler
from lfield.wire.fields import MAX_INPUT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: The longest line, in characters; the rest of a longer one is dropped.
MAX_LINE = MAX_INPUT
#: The number of lines that are kept while no thread waits.
MAX_KEPT = 16
#: The reason why a line was not accepted.
NO_READER = "{agent} does not wait for a line any more"
TOO_MANY = f"{MAX_KEPT} lines are kept already, and no agent of this host reads them"


class _Reader(Struct, eq=False):
    """A thread that waits for a line; `seconds` is its limit."""

    agent: Agent
    thread: int
    seconds: float


class OperatorInput:
    """The input of one host. `enter` adds a line."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._stored_lines: deque[str] = deque()
        self._readers: list[_Reader] = []

    def handlers(self) -> Mapping[str, Callable[[Agent, int, int, list[int]], None]]:
        """The handler of each instruction."""
        return {"read_line": self._read}

    @property
    def waiting_agents(self) -> list[str]:
        """The agents that wait for a line, in the order in which they get lines."""
        return list(dict.fromkeys(reader.agent.id for reader in self._readers if _is_waiting(reader)))

    def enter(self, text: str, *, is_kept: bool, agent: str = "") -> str:
        """Pass a line to the first waiting thread, of any agent or of `agent`; without a waiting thread the
        line is kept, if `is_kept`.

        Returns the reason why it was not accepted, '' if it was.
        """
        text = text[:MAX_LINE]
        self._drop_ended()
        reader = next((waiter for waiter in self._readers if agent in ("", waiter.agent.id)), None)
        if reader is not None:
            self._readers.remove(reader)
            self._complete(reader.agent, reader.thread, text)
            self._report()
            return ""
        if not is_kept:
            return NO_READER.format(agent=agent)
        if len(self._stored_lines) >= MAX_KEPT:
            return TOO_MANY
        self._stored_lines.append(text)
        return ""

    def cancel(self, agent: Agent, thread: int) -> bool:
        """Remove a thread that waits for a line, whose call is cancelled; False if it waits for no line."""
        found = [reader for reader in self._readers if reader.agent is agent and reader.thread == thread]
        for reader in found:
            self._readers.remove(reader)
            self._report()
        return bool(found)

    def _drop_ended(self) -> None:
        """Remove the threads of agents that have died."""
        self._readers = [reader for reader in self._readers if _is_waiting(reader)]

    def _report(self) -> None:
        self._scheduler.world.on_readers_changed(self.waiting_agents)

    def _read(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        scheduler, seconds = self._scheduler, real_from_bits(words[0])
        if math.isnan(seconds):
            scheduler.throw_builtin(agent, thread, "ArithmeticException", "a time limit is not a number")
            return
        scheduler.end_line(agent, thread)
        scheduler.open(agent)
        if self._stored_lines:
            self._complete(agent, thread, self._stored_lines.popleft())
            return
        reader = _Reader(agent, thread, seconds)
        scheduler.set_state(agent, thread, WAITING)
        if not seconds > 0:
            self._throw_expired(reader)
            return
        self._readers.append(reader)
        scheduler.run_queue.set_alarm(agent, min(seconds, 1e9), partial(self._expire, reader))
        scheduler.world.on_input_awaited(agent, seconds)
        self._report()

    def _complete(self, agent: Agent, thread: int, text: str) -> None:
        self._scheduler.world.on_line_read(agent, text)
        self._scheduler.complete(agent, thread, lambda: agent.block.new_string(text))

    def _expire(self, reader: _Reader) -> None:
        """The limit of a thread is over, unless it has a line already."""
        if reader in self._readers:
            self._readers.remove(reader)
            self._report()
            self._throw_expired(reader)

    def _throw_expired(self, reader: _Reader) -> None:
        host = self._scheduler.world.host_of(reader.agent.member)
        message = (
            f"no line was entered at {host} within {reader.seconds:g} s: type the line in the terminal of "
            f"{host}, in the terminal of lfield up --all as {host}: TEXT, or on the page of lfield watch"
        )
        self._scheduler.throw_builtin(
            reader.agent, reader.thread, "TimeLimitException", message, reader.agent.id
        )


def _is_waiting(reader: _Reader) -> bool:
    return not reader.agent.ended and bool(place_of(reader.agent.block, reader.thread))
