"""Records the actions of programs and the ends of coordinators in a scenario, as a digest.

A refactoring keeps the digest: it covers no name of a module, class or message, no message size, no log line
and no message of an exception. It covers, with virtual times: program output, starts, arrivals, departures
and reservations of coordinators, exceptions that resume them, commands of devices, orders of the operator,
exit statuses, and the hosts of coordinators at the end. Simultaneous events of different hosts have no order.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence

from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.host_fleet import Fleet, HostRun, copies
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.pending_call import CallKey
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.reservation_messages import RenewReservation
from simulation_testing.invariants.host_taps import tap


class OutcomeRecorder:
    """Records one scenario; `on_host_start` must be called with every life of a host."""

    def __init__(self) -> None:
        self._timeline: EventQueue
        self._events: list[tuple[str, str, str]] = []

    def on_host_start(self, name: str, life: HostRun) -> None:
        """A host's process begins."""
        self._timeline = life.process.loop.machine.timeline
        self._add(name, "boot")
        tap(life, self)

    def digest(self, fleet: Fleet, orders: Mapping[str, int], breaches: Sequence[str]) -> str:
        """The digest of the scenario, after its end and before its team is closed.

        `orders` counts the executed orders of the operator by kind, `breaches` names those found.
        """
        lines = [" ".join(event) for event in sorted(self._events, key=lambda event: event[:2])]
        lines += [*_commands(fleet), *_end(fleet)]
        lines += [f"order {kind} {count}" for kind, count in sorted(orders.items())]
        lines += [f"breach {name}" for name in breaches]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def _add(self, host: str, *parts: object) -> None:
        self._events.append((_seconds(self._timeline.now), host, " ".join(map(str, parts))))

    # --- events of `tap` --------------------------------------------------------------------------------

    def on_started(self, life: HostRun, agent: Agent) -> None:
        """A coordinator was started."""
        self._add(life.core.name, "start", agent.id, agent.generation)

    def on_transfer(self, life: HostRun, header: Transfer) -> None:
        """Not recorded: `on_admitted` is recorded."""

    def on_admitted(self, life: HostRun, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into the machine."""
        self._add(life.core.name, "admit", agent.id, agent.generation, agent.sequence, came)

    def on_restored(self, life: HostRun, agent: Agent) -> None:
        """A coordinator was put into the machine from the host's own disk."""
        self._add(life.core.name, "restore", agent.id, agent.generation, agent.sequence)

    def on_resumed(self, life: HostRun, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again, with an exception of this kind."""
        self._add(life.core.name, "resume", agent.id, agent.generation, kind)

    def on_sent(self, life: HostRun, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent to another host."""
        self._add(life.core.name, "send", header.agent, header.generation, header.sequence, target)

    def on_step(self, life: HostRun) -> None:
        """Not recorded: the number of steps is internal."""

    def on_output(self, life: HostRun, agent: Agent, text: str) -> None:
        """A program has written text."""
        for line in text.splitlines():
            self._add(life.core.name, "output", agent.id, _without_message(line))

    def on_result_durable(self, life: HostRun, key: CallKey) -> None:
        """Not recorded: it follows from the journal."""

    def on_granted(self, life: HostRun, agent: Agent, resource: TeamMember, number: int) -> None:
        """A coordinator has reserved a resource."""
        self._add(life.core.name, "reserve", agent.id, resource.id)

    def on_dropped(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator has released its reservations."""
        self._add("", "release", agent.id, *(resource.id for resource, _ in held))

    def on_reserved_call(
        self, life: HostRun, agent: Agent, resource: TeamMember, number: int, *, lost: bool
    ) -> None:
        """Not recorded: the effect of the call is."""

    def on_renewed(self, message: RenewReservation) -> None:
        """Not recorded: a message."""


def _seconds(at: float) -> str:
    return f"{at:13.6f}"


#: The text before the message of an exception in the output of the programs.
_MESSAGE = re.compile(r"(restarted \S+ \S+|.* also failed: \w+).+")


def _without_message(line: str) -> str:
    """The line without the message of an exception: messages are wording, not behaviour."""
    found = _MESSAGE.fullmatch(line)
    return found[1] if found else line


def _commands(fleet: Fleet) -> list[str]:
    return [
        f"{_seconds(command.at)} {name} {command.what} {command.arguments} {command.safe}"
        for name, hardware in sorted(fleet.hardware.items())
        for command in hardware.record
    ]


def _end(fleet: Fleet) -> list[str]:
    return [
        f"over {_seconds(fleet.now)}",
        *(f"exit {name} {status}" for name, status in sorted(fleet.left.items())),
        *(f"failed {name}" for name in sorted(fleet.failed)),
        *(f"gone {name}" for name in sorted(fleet.lost_hosts)),
        *(f"runs {start} {sorted(hosts)}" for start, hosts in sorted(copies(fleet).items())),
    ]
