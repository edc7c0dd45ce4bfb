"""Orders and queries of an operator to the hosts of a team: the I/O shell behind the buttons of the page."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Mapping
from functools import cached_property, partial

from msgspec.structs import replace

from lfield.authority.identity import Identity
from lfield.authority.peer_verification import AdmissionDecision
from lfield.authority.rights import missing_permission
from lfield.client.capability_query import TeamQueries
from lfield.client.team_connection import HostSnapshots, TeamConnection
from lfield.errors import LfieldError, ProgramError
from lfield.mission.access.access_rules import NO_RULES, Access
from lfield.net.peer_credentials import own_process_identity
from lfield.net.transport import UNIX
from lfield.operator.client import (
    PATIENT_SNAPSHOT,
    OrderOnOpenLink,
    ask_all,
    emergency_stop,
    pause,
    unanswered,
)
from lfield.operator.dashboard.operator_actions import OrderObserver, OrderOutcome, QueryAnswer
from lfield.operator.observer_link import Request, input_line
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult, Pause
from lfield.wire.order_messages import ID_SIZE, OrderKind

#: Each order as a message, only to look up the right that it needs.
_NO_ID = bytes(ID_SIZE)
_MESSAGES: Mapping[OrderKind, EmergencyStop | Pause] = {
    "stop": EmergencyStop(_NO_ID, ""),
    "lift": EmergencyStop(_NO_ID, "", lift=True),
    "pause": Pause(_NO_ID),
    "resume": Pause(_NO_ID, lift=True),
}

RunInThread = Callable[
    [Callable[[str, HostSnapshots], QueryAnswer], str, HostSnapshots], Awaitable[QueryAnswer]
]


def stop_order(reason: str) -> Request[EmergencyStopResult]:
    """The emergency stop of a person."""
    return emergency_stop(f"the emergency stop was pressed{': ' if reason else ''}{reason}")


class TeamActions:
    """Implements `OperatorActions` for the hosts of a team; `observer` gets each answer when it arrives.

    `read_queries` reads the data for queries, at the first query; its error is the answer when that fails.
    `access`: the mission's restrictions of this person's rights, as far as this computer has them.
    `open_links` sends orders over open connections. `run_in_thread` runs a long computation outside the event
    loop.
    """

    def __init__(
        self,
        connection: TeamConnection,
        observer: OrderObserver,
        read_queries: Callable[[], TeamQueries],
        access: Access = NO_RULES,
        open_links: OrderOnOpenLink | None = None,
        run_in_thread: RunInThread = asyncio.to_thread,
    ) -> None:
        self._connection, self._observer, self._read_queries = connection, observer, read_queries
        self._access, self._open_links, self._run_in_thread = access, open_links, run_in_thread
        self._queries: TeamQueries | None = None

    # --- permissions ----------------------------------------------------------------------------------

    @property
    def denied_orders(self) -> Mapping[OrderKind, str]:
        """The orders that every host would refuse from this person, each with a reason."""
        found: dict[OrderKind, str] = {}
        identities = [self._identity_at(address) for address in self._connection.locate.addresses.values()]
        for order, message in _MESSAGES.items():
            reasons = [
                self._missing_right(identity, message) for identity in identities if identity is not None
            ]
            if reasons and all(reasons):
                found[order] = reasons[0]
        return found

    def _missing_right(self, identity: Identity, message: EmergencyStop | Pause) -> str:
        return missing_permission(
            identity, AdmissionDecision("all", denied_rights=self._access.denied_rights(identity)), message
        )

    def _identity_at(self, address: str) -> Identity | None:
        """The identity of this person at a host; None if only the host can determine it."""
        if not address.startswith(UNIX):
            return self._own_identity
        try:
            return own_process_identity(os.stat(address.removeprefix(UNIX)).st_uid)
        except OSError:
            return None

    @cached_property
    def _own_identity(self) -> Identity | None:
        """The identity in the own certificate. Hosts decide whether it is valid now."""
        keys = self._connection.keys
        if keys is None:
            return None
        from lfield.authority.certificate_reader import identity_in

        return identity_in(keys.certificate, keys.authority)

    # --- orders ---------------------------------------------------------------------------------------

    async def stop(self, reason: str = "") -> OrderOutcome:
        """See `OperatorActions.stop`."""
        return await self._order("stop", stop_order(reason))

    async def lift(self) -> OrderOutcome:
        """See `OperatorActions.lift`."""
        return await self._order("lift", emergency_stop("the emergency is over", lift=True))

    async def pause(self) -> OrderOutcome:
        """See `OperatorActions.pause`."""
        return await self._order("pause", pause())

    async def resume(self) -> OrderOutcome:
        """See `OperatorActions.resume`."""
        return await self._order("resume", pause(lift=True))

    async def _order(self, order: OrderKind, request: Request[EmergencyStopResult]) -> OrderOutcome:
        confirmed: list[str] = []
        unconfirmed: dict[str, str] = {}
        unreached: dict[str, str] = {}
        problems: dict[str, str] = {}
        number = self._observer.on_order(order, self._connection.locate.hosts)
        on_answer = partial(self._observer.on_answer, number)
        answers = await self._connection.order(request, self._open_links, on_answer)
        for host, answer in answers.items():
            if isinstance(answer, LfieldError):
                unreached[host] = str(answer)
                continue
            confirmed += [device for device, problem in answer.devices.items() if not problem]
            unconfirmed |= {device: problem for device, problem in answer.devices.items() if problem}
            if answer.trouble:
                problems[host] = answer.trouble
        return OrderOutcome(order, tuple(confirmed), unconfirmed, unreached, problems)

    async def enter(self, host: str, agent: str, text: str) -> str:
        """See `OperatorActions.enter`."""
        at = self._connection
        address = at.locate.addresses.get(host)
        if address is None:
            return f"there is no host {host}"
        answers = await ask_all(at.transport, {host: address}, input_line(agent, text), at.crl)
        answer = answers[host]
        return str(answer) if isinstance(answer, LfieldError) else answer.trouble

    # --- questions ------------------------------------------------------------------------------------

    async def query(self, text: str) -> QueryAnswer:
        """See `OperatorActions.query`: as `lfield query --explain`, from the running hosts."""
        snapshots = await self._connection.snapshots(PATIENT_SNAPSHOT)
        return await self._run_in_thread(self._match, text, snapshots)

    def _match(self, text: str, snapshots: HostSnapshots) -> QueryAnswer:
        try:
            queries = self._queries = self._queries or self._read_queries()
            question, known = queries.parse(text), queries.known_team(snapshots)
            answers = queries.answers(question, known)
        except ProgramError as error:
            return QueryAnswer(text, mistakes="\n".join(found.render() for found in error.diagnostics))
        except LfieldError as error:
            return QueryAnswer(text, mistakes=str(error))
        if not known.is_running:
            answers = [replace(each, notes=[str(known), *each.notes]) for each in answers]
        silent = {host: str(error) for host, error in unanswered(snapshots).items()}
        units = {name: attribute.unit for name, attribute in queries.context.registry.attributes.items()}
        return QueryAnswer(text, answers, silent, units=units)
