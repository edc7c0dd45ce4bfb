"""Orders and queries of an operator to the hosts of a team: the I/O shell behind the buttons of the page."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial

from lfield.authority.identity import Identity
from lfield.authority.key_material import Keys
from lfield.authority.peer_verification import AdmissionDecision
from lfield.authority.rights import missing_permission
from lfield.capability.matching.matcher import Matcher
from lfield.errors import LfieldError, ProgramError
from lfield.mission.access.access_rules import NO_RULES, Access
from lfield.mission.team import Team
from lfield.net.peer_credentials import own_process_identity
from lfield.net.transport import UNIX, Transport
from lfield.operator.client import (
    PATIENT_SNAPSHOT,
    OrderOnOpenLink,
    ask_all,
    emergency_stop,
    pause,
)
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.dashboard.operator_actions import (
    OrderObserver,
    OrderOutcome,
    PrimitiveMatches,
    QueryAnswer,
)
from lfield.operator.observer_link import PresentedCrl, Request, input_line
from lfield.operator.orders.order_sender import OrderSender
from lfield.operator.query_parser import parse_query
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_state import HostState
from lfield.operator.team_query import QueryContext, directory_views, primitive_answer, roster_from_hosts
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
    [Callable[[str, Mapping[str, HostState]], QueryAnswer], str, Mapping[str, HostState]],
    Awaitable[QueryAnswer],
]


@dataclass(frozen=True, slots=True)
class OperatorContext:
    """The operator and the transports of the orders.

    `keys`: those of this person, None for none. `crl`: a revocation list for hosts with an older one.
    `access`: the mission's restrictions of this person's rights, as far as this computer has them. `sender`:
    sends orders as signed datagrams. `standing`: sends them over open connections.
    """

    keys: Keys | None = None
    crl: PresentedCrl | None = None
    access: Access = NO_RULES
    sender: OrderSender | None = None
    standing: OrderOnOpenLink | None = None


NO_OPERATOR = OperatorContext()


class OrderService:
    """Implements `OperatorActions` for the hosts of a team; `observer` gets each answer when it arrives.

    `read_context` reads what queries need, at the first query; its error is the answer when that fails.
    `run_in_thread` runs a long computation outside the event loop.
    """

    def __init__(
        self,
        transport: Transport,
        locate: HostLocator,
        observer: OrderObserver,
        team: Team,
        read_context: Callable[[], QueryContext],
        operator: OperatorContext = NO_OPERATOR,
        run_in_thread: RunInThread = asyncio.to_thread,
    ) -> None:
        self._run_in_thread = run_in_thread
        self._transport, self._locate, self._observer = transport, locate, observer
        self._team, self._read_context = team, read_context
        self._keys, self._crl, self._access = operator.keys, operator.crl, operator.access
        self._sender, self._standing = operator.sender, operator.standing
        self._context: QueryContext | None = None

    # --- permissions ----------------------------------------------------------------------------------

    @property
    def denied_orders(self) -> Mapping[OrderKind, str]:
        """The orders that every host would refuse from this person, each with a reason."""
        found: dict[OrderKind, str] = {}
        who = [self._identity_at(address) for address in self._locate.addresses.values()]
        for order, message in _MESSAGES.items():
            reasons = [self._missing_right(identity, message) for identity in who if identity is not None]
            if reasons and all(reasons):
                found[order] = reasons[0]
        return found

    def _missing_right(self, who: Identity, message: EmergencyStop | Pause) -> str:
        return missing_permission(
            who, AdmissionDecision("all", denied_rights=self._access.denied_rights(who)), message
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
        if self._keys is None:
            return None
        from lfield.authority.certificate_reader import identity_in

        return identity_in(self._keys.certificate, self._keys.authority)

    # --- orders ---------------------------------------------------------------------------------------

    async def stop(self, reason: str = "") -> OrderOutcome:
        """See `OperatorActions.stop`."""
        text = f"the emergency stop was pressed{': ' if reason else ''}{reason}"
        return await self._order("stop", emergency_stop(text))

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
        troubles: dict[str, str] = {}
        addresses = dict(self._locate.addresses)
        number = self._observer.on_order(order, addresses)
        answers = await ask_all(
            self._transport,
            addresses,
            request,
            self._crl,
            self._sender,
            self._standing,
            partial(self._observer.on_answer, number),
        )
        for host, answer in answers.items():
            if isinstance(answer, LfieldError):
                unreached[host] = str(answer)
                continue
            confirmed += [device for device, problem in answer.devices.items() if not problem]
            unconfirmed |= {device: problem for device, problem in answer.devices.items() if problem}
            if answer.trouble:
                troubles[host] = answer.trouble
        return OrderOutcome(order, tuple(confirmed), unconfirmed, unreached, troubles)

    async def enter(self, host: str, text: str) -> str:
        """See `OperatorActions.enter`."""
        addresses = dict(self._locate.addresses)
        if host not in addresses:
            return f"there is no host {host}"
        answers = await ask_all(self._transport, {host: addresses[host]}, input_line(text), self._crl)
        answer = answers[host]
        return str(answer) if isinstance(answer, LfieldError) else answer.trouble

    # --- questions ------------------------------------------------------------------------------------

    async def query(self, text: str) -> QueryAnswer:
        """See `OperatorActions.query`: as `lfield query --explain`, from the running hosts."""
        answers = await ask_all(self._transport, self._locate.addresses, PATIENT_SNAPSHOT, self._crl)
        return await self._run_in_thread(self._match, text, host_states(answers))

    def _match(self, text: str, hosts: Mapping[str, HostState]) -> QueryAnswer:
        try:
            asked = self._context = self._context or self._read_context()
            question = parse_query(text, asked.registry)
        except ProgramError as error:
            return QueryAnswer(text, mistakes="\n".join(found.render() for found in error.diagnostics))
        except LfieldError as error:
            return QueryAnswer(text, mistakes=str(error))
        unreachable = {name: host.trouble for name, host in hosts.items() if not host.linked}
        team = roster_from_hosts(
            asked.registry, self._team.deployed, directory_views(hosts), unreachable.keys()
        )
        matcher = Matcher(asked.registry, team, asked.ways)
        units = {name: attribute.unit for name, attribute in asked.registry.attributes.items()}
        answers = [primitive_answer(matcher, primitive, question) for primitive in question.primitives]
        found = [
            PrimitiveMatches(each.primitive, each.offers, each.count, each.refusals, each.notes, units)
            for each in answers
        ]
        return QueryAnswer(text, tuple(found), unreachable)
