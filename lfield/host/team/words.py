"""What a person's word does to one host: `lfield forget`, `recover`, `pause`, `estop`. Pure.

A person cannot see what this host has now, so its own knowledge comes first: what is alive here stays.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases, abandon
from lfield.journal.pages import Paused, Stopped
from lfield.mobility.departures import PERHAPS
from lfield.mobility.generations import next_recovery
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.wire.fields import clip
from lfield.wire.observing import Recover, Recovered


def forget(team: Coordinators, agent: str) -> list[int]:
    """A coordinator is lost; the starts of it that end here."""
    starts, effects = team.mobility.forget(agent, "given up by 'lfield forget'")
    if starts:
        team.say(f"{agent} is given up as lost: somebody ran 'lfield forget'")
    team.carry_out(effects)
    return starts


def recover(team: Coordinators, leases: Leases, host: str, number: int, word: Recover) -> Recovered:
    """Whoever held a coordinator is gone for good: `host`, with this number in the team, goes on with it.

    What the person was told of must still be so. No start up to its fence may be made here. One that has
    terminated is not recovered; under leases that is known to whoever has heard a majority just now.
    """
    if why := leases.why_not_recovered(word.agent, word.generation) or _why_not(team, host, word):
        return Recovered(0, clip(why))
    fence = leases.quorum.fences.of(word.agent)
    known = [row.generation for row in team.mobility.knowledge() if row.agent == word.agent]
    generation = next_recovery(max(word.above, fence, *known), number)
    if not team.recover(word.agent, generation):
        left = f"what {host} has kept of {word.agent} cannot be read"
        return Recovered(0, f"{left}; ask again: another host may have an older copy")
    return Recovered(generation)


def pause(team: Coordinators, machine: Machine, now: float, *, on: bool, order: bytes) -> None:
    """No agent of this host runs any more, or all go on; again is nothing new. `now` is in seconds, `order`
    is the id of the order.

    The vehicles come down, so a call that is under way does not go on as if nothing had been: its coordinator
    is told. What waits for another host waits as long as if there had been no pause.
    """
    team.keep(Paused(on, order))
    if team.paused == on:
        return
    team.paused = on
    team.say("the mission is paused: no agent runs here" if on else "the mission goes on")
    if not on:
        team.mobility.postpone(now)
        return
    begun = {call.agent for call in machine.begun_calls()}
    here = {agent.id for agent in machine.agents.values() if agent.member.kind == "coordinator"}
    for coordinator in sorted(begun | here):
        abandon(machine, coordinator, f"the mission was paused; {PERHAPS}")


def stop(team: Coordinators, reason: str, order: bytes) -> None:
    """The devices of this host are barred by an emergency stop, for that reason; or no more, with ''.
    `order` is the id of the order, b"" for a lock-out.

    Whoever has them knows already: here it is only kept, for the next life of this host.
    """
    team.stopped = reason
    team.keep(Stopped(reason, order))


def _why_not(team: Coordinators, host: str, word: Recover) -> str:
    if team.halted:
        return f"{host} is stopping"
    if team.trouble:
        return f"{host} can keep nothing: {team.trouble}"
    left = team.mobility.recoverable(word.agent)
    if left is None:
        return f"{host} has nothing of {word.agent} to go on with, or it is alive there"
    if left.state == "RUN":
        return f"{word.agent} goes on by itself: {host} was just started again"
    if left.state == "PREPARED":
        return f"{word.agent} is on its way from {host} to {left.where}"
    if (left.generation, left.sequence) != (word.generation, word.sequence):
        return f"what {host} has of {word.agent} has changed meanwhile; ask again"
    return ""


def waits(team: Coordinators, machine: Machine, hosts: Sequence[str], agent: Agent) -> str:
    """What a frozen coordinator waits for, in a word or two: it is only kept, or it leaves."""
    if agent.too_far:
        return "cannot be there in time"
    if team.trouble and team.keeping.holds_back(agent.id):
        return "waits for its disk"
    if not team.is_leaving(agent):
        return "being kept"
    called = machine.calling(agent) if machine.fetches(agent) else None
    return f"fetches from {hosts[called[0].host]}" if called else "leaving"
