"""What mobility decides about the coordinators of a host, as events: it hears of every effect. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lfield.host.sight.teller import Teller
from lfield.mobility import effects as mobile
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.wire.coordinators import Transfer


class Hops:
    """Tells what becomes of the coordinators of the host `here`; `hosts` are those of the deployment."""

    def __init__(self, teller: Teller, machine: Machine, here: str, hosts: Sequence[str]) -> None:
        self._teller, self._machine, self._here, self._hosts = teller, machine, here, hosts
        #: The coordinators that came and do not run yet: from whom, and with which header.
        self._coming: dict[str, tuple[str, Transfer]] = {}
        self._tellers: dict[type[mobile.Effect], Callable[[Any], None]] = {
            mobile.SendTransfer: self._left,
            mobile.Go: self._goes,
            mobile.Departed: self._departed,
            mobile.Began: self._began,
            mobile.InDoubt: self._in_doubt,
            mobile.Supersede: self._superseded,
            mobile.Finished: self._finished,
        }

    def arrives(self, host: str, header: Transfer) -> None:
        """A coordinator came; whether it runs is decided later."""
        self._coming[header.agent] = host, header

    def tell(self, effect: mobile.Effect) -> None:
        """It is about to be carried out."""
        if (tell := self._tellers.get(type(effect))) is not None:
            tell(effect)

    def _left(self, effect: mobile.SendTransfer) -> None:
        header = effect.header

        def calling() -> tuple[str, str]:
            agent = self._machine.agents.get(header.agent)
            _, resource, portal = self._calling(agent) if agent is not None else ("", "", "")
            return resource, portal

        name = header.agent, header.generation, header.sequence
        self._teller.left(name, effect.host, header.size, calling)

    def _goes(self, effect: mobile.Go) -> None:
        came = self._coming.pop(effect.agent, None)
        if came is None:
            return
        host, header = came
        agent = self._machine.agents.get(effect.agent)
        # What came before and was refused is none of this one's.
        if agent is not None and (agent.generation, agent.sequence) == (header.generation, header.sequence):
            self._teller.came((header.agent, header.generation, header.sequence), host, header.size)

    def _departed(self, effect: mobile.Departed) -> None:
        self._teller.hopped((effect.agent, effect.generation, effect.sequence), effect.host)

    def stays(self, agent: Agent, exception: str, reason: str, *, recovered: bool) -> None:
        """A frozen coordinator is about to go on here by an exception, perhaps since it is `recovered`."""
        if recovered:
            self._teller.recovered(agent.id, agent.generation)
            return
        to, _, _ = self._calling(agent)
        self._teller.stayed((agent.id, agent.generation, agent.sequence), to, exception, reason)

    def _calling(self, agent: Agent) -> tuple[str, str, str]:
        """The host, the resource and the portal that a coordinator stands at, when it is frozen."""
        called = self._machine.calling(agent) if agent.frozen else None
        return (self._hosts[called[0].host], called[0].id, called[1]) if called is not None else ("", "", "")

    def _began(self, effect: mobile.Began) -> None:
        self._teller.started(effect.agent, effect.generation)

    def _in_doubt(self, effect: mobile.InDoubt) -> None:
        self._teller.doubted(effect.agent, effect.generation, effect.host, effect.reason)

    def _superseded(self, effect: mobile.Supersede) -> None:
        agent = self._machine.agents.get(effect.agent)
        if agent is not None and agent.generation == effect.generation:
            self._teller.superseded(effect.agent, effect.generation, effect.reason)

    def _finished(self, effect: mobile.Finished) -> None:
        # Each ending is told where it was; that something is lost is said by whoever finds it.
        if effect.host == self._here:
            self._teller.finished(effect.agent, effect.generation, effect.outcome, effect.detail)
