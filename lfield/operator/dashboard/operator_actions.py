"""Actions of an operator on a watched team: stop, lift, pause, resume, capability query."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from msgspec import Struct, field

from lfield.errors import LfieldError
from lfield.operator.team_query import PrimitiveAnswer
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.order_messages import OrderKind


class OrderOutcome(Struct, frozen=True):
    """The result of an order: devices that are in the required state, those that are not, unreached hosts,
    and warnings of hosts; each with a sentence. `TeamState.orders` and `TeamState.stop` show later changes.
    """

    order: OrderKind
    confirmed: tuple[str, ...] = ()
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    unreached: Mapping[str, str] = field(default_factory=dict)
    troubles: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_complete(self) -> bool:
        """Whether all hosts and devices have executed the order."""
        return not (self.unconfirmed or self.unreached)


class QueryAnswer(Struct, frozen=True):
    """The answer to a query; `mistakes` are the errors in the query, marked with carets, '' for none.
    `unanswered` are the hosts that did not answer, with the reasons. `units` are those of the attributes, by
    name."""

    question: str
    found: Sequence[PrimitiveAnswer] = ()
    unanswered: Mapping[str, str] = field(default_factory=dict)
    mistakes: str = ""
    units: Mapping[str, str] = field(default_factory=dict)


class OperatorActions(Protocol):
    """The actions of the buttons. Faults of hosts or users raise no exception: the answer contains them."""

    @property
    def denied_orders(self) -> Mapping[OrderKind, str]:
        """The actions that this operator may not perform, each with the reason and remedy: disabled
        buttons."""

    async def stop(self, reason: str = "") -> OrderOutcome:
        """Bring every device of every host into its safe state. May be repeated at any time."""

    async def lift(self) -> OrderOutcome:
        """Lift the emergency stop: programs may release their devices again."""

    async def pause(self) -> OrderOutcome:
        """Suspend all agents, and bring devices into their safe states."""

    async def resume(self) -> OrderOutcome:
        """Resume a paused mission."""

    async def enter(self, host: str, agent: str, text: str) -> str:
        """Give an agent of a host a line of input; returns the reason why the agent has not got it, or ''."""

    async def query(self, text: str) -> QueryAnswer:
        """Run `lfield query`: which agents offer a capability."""


class OrderObserver(Protocol):
    """Receives each order, and each answer when it arrives."""

    def on_order(self, order: OrderKind, hosts: Collection[str]) -> int:
        """Called when an order is sent to those hosts; returns its number."""

    def on_answer(self, number: int, host: str, answer: EmergencyStopResult | LfieldError) -> None:
        """Called with the answer of a host to that order, or the error."""
