"""Results of orders sent from here: the last one of each pair of opposites (stop and lift, pause and resume).
Sans-IO.

A result is valid until the host reports another state: a host that did not answer but has stopped, by another
path, is no longer shown as unreached.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from msgspec import Struct, field

from lfield.errors import LfieldError
from lfield.operator.team_model.team_state import HostState, OrderState
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.order_messages import OrderKind

#: The opposite of each order.
_OPPOSITE: Mapping[OrderKind, OrderKind] = {
    "stop": "lift",
    "lift": "stop",
    "pause": "resume",
    "resume": "pause",
}
#: Whether a host is in the state that an order requires.
_IS_DONE: Mapping[OrderKind, Callable[[HostState], bool]] = {
    "stop": lambda host: bool(host.stopped),
    "lift": lambda host: not host.stopped,
    "pause": lambda host: host.paused,
    "resume": lambda host: not host.paused,
}

_NOT_DONE = "it is linked again and has not executed the order: press again"


class _Command(Struct):
    """An order at `when` (s, own monotonic clock), and the answer of each host, None for none yet."""

    number: int
    order: OrderKind
    when: float
    answers: dict[str, EmergencyStopResult | str | None] = field(default_factory=dict)

    def snapshot(self, now: float, hosts: Mapping[str, HostState], unsafe: Mapping[str, str]) -> OrderState:
        pending, done = [], []
        unreached: dict[str, str] = {}
        unconfirmed: dict[str, str] = {}
        problems: dict[str, str] = {}
        for name, answer in self.answers.items():
            host = hosts.get(name)
            is_executed = host is not None and host.linked and _IS_DONE[self.order](host)
            if isinstance(answer, EmergencyStopResult):
                if is_executed or host is None or not host.linked:
                    done.append(name)
                unconfirmed |= {
                    device: reason for device, reason in answer.devices.items() if reason and device in unsafe
                }
                if answer.trouble:
                    problems[name] = answer.trouble
            elif answer is None:
                pending.append(name)
            elif is_executed:
                done.append(name)
            else:
                unreached[name] = _NOT_DONE if host is not None and host.linked else answer
        age = max(0.0, now - self.when)
        return OrderState(
            self.number, self.order, age, tuple(pending), tuple(done), unreached, unconfirmed, problems
        )


class CommandLog:
    """All orders sent from here."""

    def __init__(self) -> None:
        self._count = 0
        self._last: dict[OrderKind, _Command] = {}

    def on_order(self, order: OrderKind, hosts: Collection[str], now: float) -> int:
        """Record an order that is sent to those hosts; returns its number."""
        self._count += 1
        self._last.pop(_OPPOSITE[order], None)
        self._last[order] = _Command(self._count, order, now, dict.fromkeys(hosts))
        return self._count

    def on_answer(self, number: int, host: str, answer: EmergencyStopResult | LfieldError) -> None:
        """Record the answer of a host, or the reason why there is none. Superseded orders are ignored."""
        for press in self._last.values():
            if press.number == number:
                press.answers[host] = answer if isinstance(answer, EmergencyStopResult) else str(answer)

    def on_order_event(self, order: OrderKind, when: float) -> None:
        """Handle another operator's order that has reached a host at `when`, which may end one from here."""
        other = self._last.get(_OPPOSITE[order])
        if other is not None and when > other.when:
            del self._last[_OPPOSITE[order]]

    def snapshot(
        self, now: float, hosts: Mapping[str, HostState], unsafe: Mapping[str, str]
    ) -> tuple[OrderState, ...]:
        """The orders in force; `unsafe` are all devices that are not confirmed in their safe states."""
        return tuple(press.snapshot(now, hosts, unsafe) for press in self._last.values())
