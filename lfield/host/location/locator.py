"""Location queries between the hosts of a team: `Locate` and `Located` (request and response). Pure.

All decisions that depend on the location of a coordinator use these answers: the outcome of the mission, the
dead-man's switch of devices, transfers in doubt, failover.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.host.context import HostContext, Part
from lfield.host.effects import WAKE_WAITERS
from lfield.host.team.part_interfaces import CoordinatorOperations, LeaseRules, StateObserver
from lfield.replication.transfer.effects import Send
from lfield.wire.coordinator_messages import CoordinatorState, Locate, Located


class Locator(Part):
    """Answers location queries of other hosts, and passes the answers of other hosts on to the parts that use
    them.

    States come from the coordinator records of this host, lease records from its leases. An answer without an
    `agents` list is complete, so only such answers count for the outcome of the mission.
    """

    def __init__(
        self,
        context: HostContext,
        team: CoordinatorOperations,
        leases: LeaseRules,
        commands: StateObserver,
    ) -> None:
        self._team, self._leases, self._commands, self._own_host = team, leases, commands, context.name
        self._out = context.effects.append
        #: The last answer of each host to a query about all coordinators; see `clear`.
        self.answers: dict[str, Sequence[CoordinatorState]] = {}
        self.handles = {Locate: self._on_locate, Located: self._on_located}

    def clear(self) -> None:
        """Discard all answers: a new query starts."""
        self.answers.clear()

    def known_states(self, agents: Sequence[str] = ()) -> list[CoordinatorState]:
        """The states of these coordinators that may be reported to other hosts; without `agents`, of all
        coordinators.
        """
        known = self._team.mobility.known_states()
        named = [row for row in known if row.agent in agents] if agents else known
        return self._team.write_ahead.durable_states(named, self._own_host)

    def _on_locate(self, host: str, query: Locate) -> None:
        found = self._leases.records(query.agents) if query.leases else []
        # Other hosts rely on a lease record, so it waits for the disk. A state is only a hint.
        pending = [record for record in found if self._team.write_ahead.is_pending_durable(record.agent)]
        ready = [record for record in found if record not in pending]
        self._out(Send(host, Located(query.agents, self.known_states(query.agents), ready)))
        answers = (Located([record.agent], [], [record]) for record in pending)
        self._team.apply_effects([Send(host, answer) for answer in answers])

    def _on_located(self, host: str, answer: Located) -> None:
        if not answer.agents:
            self.answers[host] = answer.states
            self._out(WAKE_WAITERS)
        self._commands.on_states(host, answer.states)
        self._team.apply_effects(self._team.mobility.on_states(host, answer.states))
        for record in answer.leases:
            self._leases.on_located(host, record)
