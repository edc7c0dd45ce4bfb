"""The part of a host that receives orders; a subclass adds the network and the time."""

from __future__ import annotations

import random
from collections.abc import Callable

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.key_material import Keys
from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner, verify_order
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.errors import LfieldError
from lfield.host.order_history.executed_orders import ExecutedOrders
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.host.stop_orders.order_executor import OrderCallback
from lfield.host.stop_orders.order_receiver import OrderPorts, OrderReceiver, PendingCheck
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult, OrderChallenge, Pause
from lfield.wire.order_messages import OrderKind, RelayedAnswer, RelayedOrder


class OrderHost:
    """A host whose devices take `slow` seconds to be safe. `at`: its time of day, in seconds since 1970."""

    def __init__(self, own: Keys, at: float, rng: random.Random, device: str, slow: float) -> None:
        self.own, self.at, self.rng, self.slow = own, at, rng, slow
        self.devices = {device: ""}
        self.revoked: frozenset[str] = frozenset()
        #: What was executed, as (kind, reason).
        self.executed: list[tuple[OrderKind, str]] = []
        self.checks, self.life = 0, 0
        self.held = {"stop": False, "pause": False}
        self.clock = ManualClock()
        self.boot()

    def now(self) -> float:
        raise NotImplementedError

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        raise NotImplementedError

    def send(self, sender: Sender, data: bytes) -> None:
        raise NotImplementedError

    def relay(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        raise NotImplementedError

    def linked(self) -> list[str]:
        raise NotImplementedError

    def boot(self, kept: dict[bytes, tuple[OrderKind, bool]] | None = None) -> None:
        """A restart: known epochs and certificates are lost."""
        self.life += 1
        self.signer, self.certificates = OrderSigner(self.own), CertificateCache(self.own.authority)
        self.orders = ExecutedOrders(self.rng.randbytes, kept)
        self.admission = CertificateAdmission(
            self.own, self.signer.identity, TrustedClock(self.clock, self.at)
        )
        ports = OrderPorts(
            send=lambda sender, data: self.send(sender, data),
            relay=self.relay,
            linked=lambda: self.linked(),
            check=self._check,
            execute=self.execute,
            later=self._later,
        )
        self.datagrams = OrderReceiver(
            self.signer, self.certificates, self.admission, lambda: self.orders.epochs, self.now, ports
        )

    def _later(self, seconds: float, event: Callable[[], None]) -> None:
        life = self.life
        self.later(seconds, lambda: event() if life == self.life else None)

    def came(self, data: bytes, desk: str = "desk", network: str = "desk") -> None:
        self.datagrams.on_datagram(data, Sender(network, desk))

    def _check(self, checking: PendingCheck) -> None:
        self.checks += 1
        found: object
        try:
            found = verify_order(checking.signed, checking.known, self.own.authority)[1]
        except LfieldError as error:
            found = error
        self._later(0.001, lambda: self.datagrams.on_checked(checking, found))  # type: ignore[arg-type]

    def execute(self, message: EmergencyStop | Pause, who: str, answer: OrderCallback) -> None:
        kind, hold = message.kind, "stop" if isinstance(message, EmergencyStop) else "pause"
        standing = self.orders.standing_of(kind, message.id, message.epoch)
        if standing == "new":
            self.orders.mark_executed(kind, message.id)
            self.executed.append((kind, getattr(message, "reason", "")))
            self.held[hold] = not message.lift
            self._later(self.slow, lambda: self._answer(message, answer))
        elif standing in ("holds", "done", "ended"):
            self._answer(message, answer, "" if standing != "ended" else "ended")
        elif standing == "old" and message.lift:
            self._answer(message, answer, "newer")
        else:
            answer(OrderChallenge(message.id, self.orders.epochs))

    def _answer(self, message: EmergencyStop | Pause, answer: OrderCallback, trouble: str = "") -> None:
        answer(EmergencyStopResult(dict(self.devices), trouble, message.id, self.orders.epochs))
