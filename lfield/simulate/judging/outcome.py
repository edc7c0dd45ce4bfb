"""Records what the programs of a story did and what became of its coordinators, as a digest.

A refactoring keeps the digest: it covers no name of a module, class or message, no message size, no log line
and no message of an exception. It covers, with virtual times: program output, starts, arrivals, departures
and reservations of coordinators, exceptions that let them go on, commands of devices, orders of the operator,
exit statuses, and where coordinators can run at the end. Events of different hosts at one time have no order.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence

from lfield.simulate.computers.timeline import Timeline
from lfield.simulate.fleet import Fleet, Life, copies
from lfield.simulate.judging.witness import tap
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Key
from lfield.wire.coordinators import Transfer
from lfield.wire.reservations import Renew


class OutcomeRecorder:
    """Records one story; `born` must be called with every life of a host."""

    def __init__(self) -> None:
        self._timeline: Timeline
        self._events: list[tuple[str, str, str]] = []

    def born(self, name: str, life: Life) -> None:
        """A host's process begins."""
        self._timeline = life.process.loop.machine.timeline
        self._add(name, "boot")
        tap(life, self)

    def digest(self, fleet: Fleet, orders: Mapping[str, int], breaches: Sequence[str]) -> str:
        """The digest of the story, once it is over and before its team is closed.

        `orders` counts the operator's orders that hosts carried out by kind, `breaches` names those found.
        """
        lines = [" ".join(event) for event in sorted(self._events, key=lambda event: event[:2])]
        lines += [*_commands(fleet), *_end(fleet)]
        lines += [f"order {kind} {count}" for kind, count in sorted(orders.items())]
        lines += [f"breach {name}" for name in breaches]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def _add(self, host: str, *words: object) -> None:
        self._events.append((_seconds(self._timeline.now), host, " ".join(map(str, words))))

    # --- what `tap` shows -------------------------------------------------------------------------------

    def started(self, life: Life, agent: Agent) -> None:
        """A coordinator was started."""
        self._add(life.core.name, "start", agent.id, agent.generation)

    def came(self, life: Life, header: Transfer) -> None:
        """Not recorded: `admitted` is what matters."""

    def admitted(self, life: Life, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into the machine."""
        self._add(life.core.name, "admit", agent.id, agent.generation, agent.sequence, came)

    def restored(self, life: Life, agent: Agent) -> None:
        """A coordinator was put into the machine as the host's own disk has it."""
        self._add(life.core.name, "restore", agent.id, agent.generation, agent.sequence)

    def may_run(self, life: Life, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again, with an exception of this kind."""
        self._add(life.core.name, "resume", agent.id, agent.generation, kind)

    def sent(self, life: Life, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent to another host."""
        self._add(life.core.name, "send", header.agent, header.generation, header.sequence, target)

    def turned(self, life: Life) -> None:
        """Not recorded: how often a host looks is its own affair."""

    def said(self, life: Life, agent: Agent, text: str) -> None:
        """A program has written something."""
        for line in text.splitlines():
            self._add(life.core.name, "output", agent.id, _without_message(line))

    def told(self, life: Life, key: Key) -> None:
        """Not recorded: it follows from the journal."""

    def given(self, life: Life, agent: Agent, resource: Member, number: int) -> None:
        """A coordinator has reserved a resource."""
        self._add(life.core.name, "reserve", agent.id, resource.id)

    def dropped(self, agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        """A coordinator has given back what it had reserved."""
        self._add("", "release", agent.id, *(resource.id for resource, _ in held))

    def asked(self, life: Life, agent: Agent, resource: Member, number: int, *, lost: bool) -> None:
        """Not recorded: what comes of the call is."""

    def renewed(self, message: Renew) -> None:
        """Not recorded: a message."""


def _seconds(at: float) -> str:
    return f"{at:13.6f}"


#: What precedes the message of an exception in the output of a story's programs.
_MESSAGE = re.compile(r"(restarted \S+ \S+|.* has thrown too: \w+).+")


def _without_message(line: str) -> str:
    """The line without the message of an exception: messages are wording, not behaviour."""
    found = _MESSAGE.fullmatch(line)
    return found[1] if found else line


def _commands(fleet: Fleet) -> list[str]:
    return [
        f"{_seconds(told.at)} {name} {told.what} {told.arguments} {told.safe}"
        for name, hardware in sorted(fleet.hardware.items())
        for told in hardware.record
    ]


def _end(fleet: Fleet) -> list[str]:
    return [
        f"over {_seconds(fleet.now)}",
        *(f"exit {name} {status}" for name, status in sorted(fleet.left.items())),
        *(f"failed {name}" for name in sorted(fleet.failed)),
        *(f"gone {name}" for name in sorted(fleet.gone)),
        *(f"runs {start} {sorted(hosts)}" for start, hosts in sorted(copies(fleet).items())),
    ]
