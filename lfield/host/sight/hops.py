"""What becomes of the coordinators of a host, as events: it hears of the effects of mobility. Pure.

Those of a hop come first, and cost next to nothing where so many hop that not all are told.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.host.sight.budget import HOPS, HOPS_UNWATCHED
from lfield.host.sight.teller import Teller
from lfield.mission.team import Team
from lfield.mobility import effects as mobile
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.wire import events
from lfield.wire.coordinators import TERMINATED, Known, Transfer
from lfield.wire.fields import MAX_LABEL, age, clip


class _Away(Struct):
    """A hop that has left and is not heard of yet: its name, its event (0: in an earlier life), and when.

    `back` is when the coordinator came again, which says as much as a confirmation.
    """

    to: str
    generation: int
    sequence: int
    number: int
    up: float
    back: float = 0.0


class Hops:
    """Tells of the coordinators of a `team` on its host `here`."""

    def __init__(self, teller: Teller, machine: Machine, here: str, team: Team) -> None:
        self._teller, self._machine, self._here, self._hosts = teller, machine, here, team.hosts
        self._known = frozenset(member.id for member in team.coordinators)
        self._budget = teller.budget(HOPS, HOPS_UNWATCHED)
        #: The coordinators that came and do not run yet: from whom, and with which header.
        self._coming: dict[str, tuple[str, Transfer]] = {}
        self._away: dict[str, _Away] = {}

    # --- a hop ----------------------------------------------------------------------------------------

    def left(self, to: str, header: Transfer) -> None:
        """A coordinator is sent, or sent again, which is not told."""
        if not self._budget.take("left"):
            return
        name, away = header.agent, self._away.get(header.agent)
        if away is not None and (away.generation, away.sequence) == (header.generation, header.sequence):
            return
        agent = self._machine.agents.get(name)
        _, resource, portal = self._calling(agent) if agent is not None else ("", "", "")
        generation, sequence = header.generation, header.sequence
        portal, up = clip(portal, MAX_LABEL), self._teller.up
        what = events.Left(name, generation, sequence, to, resource, portal, header.size)
        self._away[name] = _Away(to, generation, sequence, self._teller.by(name, what), up)

    def arrives(self, host: str, header: Transfer) -> None:
        """A coordinator came; whether it runs is decided later. Of one that nobody knows nothing is kept."""
        if header.agent in self._known:
            self._coming[header.agent] = host, header
            if (away := self._away.get(header.agent)) is not None:
                away.back = self._teller.up

    def goes(self, name: str, generation: int) -> None:
        """A coordinator that has come runs here, or one that was kept goes on."""
        came = self._coming.pop(name, None)
        if came is None:
            return
        is_told, away = self._budget.take("came"), self._away.get(name)
        if not is_told and away is None:
            return
        host, header = came
        agent = self._machine.agents.get(name)
        # What came before and was refused is none of this one's.
        if agent is None or (header.generation, header.sequence) != (generation, agent.sequence):
            return
        if away is not None and away.generation == generation and away.sequence < header.sequence:
            # Who comes back at once brings the news that it was there: its host sends none besides.
            self._arrived(name, away, away.back)
        if is_told:
            what = events.Came(name, generation, header.sequence, host, header.size)
            self._teller.by(name, what, cause=0)

    def departed(self, effect: mobile.Departed) -> None:
        """Whoever sent it has heard that it came: told of those whose leaving was told."""
        away = self._away.get(effect.agent)
        if away is not None and (away.generation, away.sequence) == (effect.generation, effect.sequence):
            self._arrived(effect.agent, away, self._teller.up - effect.held)

    def _arrived(self, name: str, away: _Away, up: float) -> None:
        """It was heard then that a hop came to where it was sent."""
        del self._away[name]
        seconds = age(up - away.up) if away.number else None
        what = events.Hopped(name, away.generation, away.sequence, away.to, seconds)
        self._teller.event(what, away.number)

    def is_away(self, known: Known) -> None:
        """An earlier life of this host has sent it."""
        self._away[known.agent] = _Away(known.where, known.generation, known.sequence, 0, 0.0)

    # --- all else -------------------------------------------------------------------------------------

    def stays(self, agent: Agent, exception: str, reason: str, *, recovered: bool) -> None:
        """A frozen coordinator is about to go on here by an exception, perhaps since it is `recovered`."""
        self._away.pop(agent.id, None)
        if recovered:
            self._teller.by(agent.id, events.Recovered(agent.id, agent.generation))
        elif self._budget.take("stayed"):
            to, _, _ = self._calling(agent)
            name = agent.id, agent.generation, agent.sequence
            self._teller.by(agent.id, events.Stayed(*name, to, exception, clip(reason)))

    def tell(self, effect: mobile.Effect) -> None:
        """What happens seldom is about to be carried out."""
        match effect:
            case mobile.Began():
                self._teller.by(effect.agent, events.Started(effect.agent, effect.generation))
            case mobile.InDoubt():
                reason = clip(effect.reason)
                what = events.Doubted(effect.agent, effect.generation, effect.host, reason)
                self._teller.by(effect.agent, what)
            case mobile.Supersede():
                agent = self._machine.agents.get(effect.agent)
                if agent is not None and agent.generation == effect.generation:
                    reason = clip(effect.reason)
                    self._teller.by(effect.agent, events.Superseded(effect.agent, effect.generation, reason))
            case mobile.Finished():
                self._ended(effect)

    def _ended(self, effect: mobile.Finished) -> None:
        """A coordinator has ended somewhere: if by itself, what was sent has come there."""
        away = self._away.get(effect.agent)
        if away is not None and away.generation == effect.generation:
            if effect.outcome in TERMINATED:
                self._arrived(effect.agent, away, self._teller.up)
            else:
                del self._away[effect.agent]
        if effect.host == self._here:
            # Each ending is told where it was; that something is lost by whoever finds it.
            self._teller.finished(effect.agent, effect.generation, effect.outcome, effect.detail)

    def _calling(self, agent: Agent) -> tuple[str, str, str]:
        """The host, the resource and the portal that a coordinator stands at, when it is frozen."""
        called = self._machine.calling(agent) if agent.frozen else None
        return (self._hosts[called[0].host], called[0].id, called[1]) if called is not None else ("", "", "")
