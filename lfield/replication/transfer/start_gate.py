"""Start gate: the time when a host may start its coordinators, and their generation. Sans-IO.

Generations order the starts of a coordinator, so they must grow independently of clocks and disks. The next
generation is a counter (`generations`) above every number that this host has recorded and that any other host
knows. One counter serves all coordinators of a host, since they are started together.

A host without a record may have started its coordinators before, with another disk. It therefore waits until
every other host has reported its records, or an operator asserts that there was no earlier start.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from lfield.replication.transfer.coordinator_copies import LIVE_STATES
from lfield.replication.transfer.generations import next_start
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.coordinator_messages import CoordinatorState


class StartGate:
    """Decides on the starts of one host's coordinators `agents`; `others` are the other hosts of the team."""

    def __init__(self, agents: Collection[str], others: Collection[str]) -> None:
        self.agents = agents
        self._others, self._unanswered = others, set(others)
        #: The records in the Hellos of the linked hosts.
        self._states_of: dict[str, list[CoordinatorState]] = {}
        self._record: int | None = None
        self._newest = 0
        self._waiting = self._is_decided = False
        #: The hosts that need not report, by the devices file or an operator's command.
        self._excluded: set[str] = set()
        self._last_line = ""

    def on_states(self, host: str, known: Iterable[CoordinatorState] = ()) -> None:
        """A host has reported its records; or the host has ended permanently, and has no records."""
        self._states_of[host] = list(known)
        self._unanswered.discard(host)
        self.on_generations(self._states_of[host])

    def on_unlinked(self, host: str) -> None:
        """A link closed: the host's records may change."""
        self._states_of.pop(host, None)

    def on_generations(self, known: Iterable[CoordinatorState]) -> None:
        """Record known starts."""
        self._newest = max(self._newest, *(k.generation for k in known if k.agent in self.agents), 0)

    def require_above(self, generation: int) -> None:
        """Require a generation above this one."""
        self._newest = max(self._newest, generation)

    def exclude(self, hosts: Iterable[str]) -> None:
        """Do not wait for these hosts; earlier starts there are ignored."""
        self._excluded.update(hosts)

    def open(self, record: int | None, *, first: bool) -> None:
        """The other hosts had time to answer. `record` is the last recorded start here, None without one.

        `first`: an operator asserts that there was no earlier start.
        """
        self._record = 0 if record is None and first else record
        self._waiting = bool(self.agents)

    @property
    def is_waiting(self) -> bool:
        """Whether the other hosts had time to answer, and no coordinator has started yet."""
        return self._waiting

    @property
    def poll_due(self) -> bool:
        """Whether the coordinators are to be started now; returns True once."""
        now = self._waiting and not self.missing
        self._waiting = self._waiting and not now
        self._is_decided = self._is_decided or now
        return now

    @property
    def is_decided(self) -> bool:
        """Whether the start was decided; there may be no coordinators."""
        return self._is_decided or not self.agents

    @property
    def needed_hosts(self) -> Collection[str]:
        """The hosts to query: all hosts until the coordinators start; then the hosts that never reported,
        which may have an earlier start.
        """
        if not self.agents:
            return ()
        return self._unanswered if self._is_decided else self._others

    @property
    def missing(self) -> list[str]:
        """The hosts that must report first."""
        return sorted(self._unanswered - self._excluded) if self._record is None else []

    @property
    def unproven(self) -> list[str]:
        """The excluded hosts that never reported: an earlier start may be alive there, since there is no
        record."""
        return sorted(self._unanswered & self._excluded) if self._record is None else []

    @property
    def newest(self) -> int:
        """The highest generation that this host has recorded or another host knows."""
        return max(self._record or 0, self._newest)

    @property
    def next_generation(self) -> int:
        """The generation of a start made now; no other host knows an equal or higher one."""
        return next_start(self.newest)

    def wait_line(self) -> LogLine | None:
        """The log line with the reason for waiting; None when it has not changed."""
        if not (self._waiting and self.missing):
            return None
        agents, hosts = " and ".join(sorted(self.agents)), " and ".join(self.missing)
        line = log_messages.START_NEEDS_HISTORY.line(agents=agents, hosts=hosts)
        last, self._last_line = self._last_line, line
        return None if last == line else line

    def parked_on(self, agent: str, known: Iterable[CoordinatorState]) -> str:
        """The linked host that reported a copy of a coordinator parked for another mission; '' for none."""
        return self._where(agent, known, ("PARKED",))

    def shadow_on(self, agent: str, known: Iterable[CoordinatorState]) -> str:
        """The linked host that reported a shadow of a coordinator; '' for none."""
        return self._where(agent, known, ("MOVED", "IN DOUBT"))

    def _where(self, agent: str, known: Iterable[CoordinatorState], states: Collection[str]) -> str:
        ended = {k.generation for k in known if k.agent == agent and k.state == "EXITED"}
        for host, records in self._states_of.items():
            for record in records:
                if record.agent == agent and record.state in states and record.generation not in ended:
                    return host
        return ""

    def is_alive(self, agent: str, known: Iterable[CoordinatorState]) -> bool:
        """Whether a coordinator is alive, by what is `known` here and the reports of linked hosts."""
        own_records = [record for record in known if record.agent == agent]
        ended = {record.generation for record in own_records if record.state == "EXITED"}
        reported_records = (
            record for records in self._states_of.values() for record in records if record.agent == agent
        )
        return any(record.state in (*LIVE_STATES, "IN DOUBT") for record in own_records) or any(
            record.state in LIVE_STATES and record.generation not in ended for record in reported_records
        )
