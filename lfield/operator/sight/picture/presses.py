"""What came of the orders that were given from here: of each pair that undo one another the last. Pure.

An answer is believed for as long as the host says nothing else: who was not reached and has stopped all the
same, by another way, is not told to be unreached any more.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

from lfield.errors import LfieldError
from lfield.operator.sight.actions import Order
from lfield.operator.sight.seen import HostSeen, OrderSeen
from lfield.wire.observing import EmergencyStopped

#: What undoes an order.
_UNDOES: Mapping[Order, Order] = {"stop": "lift", "lift": "stop", "pause": "resume", "resume": "pause"}
#: Whether a host is as an order wants it.
_WANTED: Mapping[Order, Callable[[HostSeen], bool]] = {
    "stop": lambda host: bool(host.stopped),
    "lift": lambda host: not host.stopped,
    "pause": lambda host: host.paused,
    "resume": lambda host: not host.paused,
}

_HEARD_NOW = "it is heard now, and has not done it: press once more"


@dataclass(slots=True)
class _Press:
    """An order at `when` (s, our monotonic clock), and what each host has answered, None for nothing yet."""

    number: int
    order: Order
    when: float
    answers: dict[str, EmergencyStopped | str | None] = field(default_factory=dict)

    def seen(self, now: float, hosts: Mapping[str, HostSeen], unsafe: Mapping[str, str]) -> OrderSeen:
        asked, done = [], []
        unreached: dict[str, str] = {}
        unconfirmed: dict[str, str] = {}
        troubles: dict[str, str] = {}
        for name, answer in self.answers.items():
            host = hosts.get(name)
            is_as_wanted = host is not None and host.linked and _WANTED[self.order](host)
            if isinstance(answer, EmergencyStopped):
                if is_as_wanted or host is None or not host.linked:
                    done.append(name)
                unconfirmed |= {
                    device: why for device, why in answer.devices.items() if why and device in unsafe
                }
                if answer.trouble:
                    troubles[name] = answer.trouble
            elif answer is None:
                asked.append(name)
            elif is_as_wanted:
                done.append(name)
            else:
                unreached[name] = _HEARD_NOW if host is not None and host.linked else answer
        age = max(0.0, now - self.when)
        return OrderSeen(
            self.number, self.order, age, tuple(asked), tuple(done), unreached, unconfirmed, troubles
        )


class Presses:
    """All orders that were given from here."""

    def __init__(self) -> None:
        self._count = 0
        self._last: dict[Order, _Press] = {}

    def ordered(self, order: Order, hosts: Collection[str], now: float) -> int:
        """An order is given to those hosts; its number."""
        self._count += 1
        self._last.pop(_UNDOES[order], None)
        self._last[order] = _Press(self._count, order, now, dict.fromkeys(hosts))
        return self._count

    def answered(self, number: int, host: str, answer: EmergencyStopped | LfieldError) -> None:
        """What a host has answered to it, or why it has not. Orders that are over count no more."""
        for press in self._last.values():
            if press.number == number:
                press.answers[host] = answer if isinstance(answer, EmergencyStopped) else str(answer)

    def happened(self, order: Order, when: float) -> None:
        """Somebody else's order has come to a host at `when`, which may end one from here."""
        other = self._last.get(_UNDOES[order])
        if other is not None and when > other.when:
            del self._last[_UNDOES[order]]

    def seen(
        self, now: float, hosts: Mapping[str, HostSeen], unsafe: Mapping[str, str]
    ) -> tuple[OrderSeen, ...]:
        """Those that stand; `unsafe` are all devices that are not known to be in their safe states."""
        return tuple(press.seen(now, hosts, unsafe) for press in self._last.values())
