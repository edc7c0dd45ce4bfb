"""Effects of operator commands on one host: `lfield forget`, `recover`, `pause`, `resume`, `estop`. Sans-IO.

The operator's information may be outdated, so the host's own records take precedence: a coordinator that is
alive here is kept.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import TeamLeases, abandon_calls
from lfield.journal.records import EmergencyStopFlag, PauseFlag
from lfield.replication.transfer.generations import next_recovery
from lfield.replication.transfer.transfer_sender import MAYBE_STARTED
from lfield.text import log_messages
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.wire.fields import truncate
from lfield.wire.observer_messages import RecoverRequest, RecoverResponse


def declare_lost(team: Coordinators, agent: str) -> list[int]:
    """Declare a coordinator lost; returns the starts of it that end here."""
    starts, effects = team.mobility.declare_lost(agent, "given up by 'lfield forget'")
    if starts:
        team.log(log_messages.AGENT_GIVEN_UP.line(agent=agent))
    team.apply_effects(effects)
    return starts


def recover(
    team: Coordinators, leases: TeamLeases, host: str, number: int, request: RecoverRequest
) -> RecoverResponse:
    """Resume a coordinator whose holder is permanently lost on `host`, which has this `number` in the team.

    The copy that the operator confirmed must be unchanged. No start up to its fence may be made here. A
    terminated coordinator is not recovered; under leases a host knows of terminations if it was recently
    linked to a majority.
    """
    if blocker := leases.recovery_blocker(request.agent, request.generation) or _recovery_blocker(
        team, host, request
    ):
        return RecoverResponse(0, truncate(blocker))
    fence = leases.quorum.fences.token_of(request.agent)
    known = [row.generation for row in team.mobility.known_states() if row.agent == request.agent]
    generation = next_recovery(max(request.above, fence, *known), number)
    if not team.recover(request.agent, generation):
        reason = f"the copy of {request.agent} on {host} cannot be read"
        return RecoverResponse(0, f"{reason}; repeat the command: another host may have an older copy")
    return RecoverResponse(generation)


def set_paused(team: Coordinators, machine: Machine, *, on: bool, order: bytes) -> None:
    """Suspend or resume all agents of this host; repetition has no effect. `order` is the id of the order.

    The vehicles land, so a call under way does not continue: its coordinator gets an exception. A coordinator
    that waits for another host waits as long as without the pause.
    """
    team.persist(PauseFlag(on, order))
    if team.is_pause_ordered != on:
        _change_pause(team, machine, ordered=on, ballot=team.ballot)
        team.log(log_messages.MISSION_PAUSED.line() if on else log_messages.MISSION_RESUMED.line())


def set_ballot_hold(team: Coordinators, machine: Machine, ballot: bytes) -> None:
    """As `set_paused`, by the ballot about an activation in which this robot votes; b"" ends it.

    The hold is not stored: the service starts no host before it knows the result.
    """
    if team.ballot == ballot:
        return
    was_held = bool(team.ballot)
    _change_pause(team, machine, ordered=team.is_pause_ordered, ballot=ballot)
    if was_held != bool(ballot):
        team.log(log_messages.MISSION_HELD.line() if ballot else log_messages.MISSION_HOLD_ENDED.line())


def _change_pause(team: Coordinators, machine: Machine, *, ordered: bool, ballot: bytes) -> None:
    """Set both reasons for a pause. When the pause begins, calls under way end."""
    was_paused = team.paused
    team.set_paused(ordered=ordered, ballot=ballot)
    if was_paused or not team.paused:
        return
    callers = {call.agent for call in machine.pending_calls.calls() + machine.person_portals.running}
    coordinators = {agent.id for agent in machine.agents.values() if agent.member.kind == "coordinator"}
    for coordinator in sorted(callers | coordinators):
        abandon_calls(machine, coordinator, f"the mission was paused; {MAYBE_STARTED}")


def set_emergency_stop(team: Coordinators, reason: str, order: bytes) -> None:
    """An emergency stop locks the devices of this host, for that reason, or is lifted ('').

    `order` is the id of the order, b"" for a lock-out. The guards have already received the order; this
    function only records it for the next start of this host.
    """
    team.set_stopped(reason)
    team.persist(EmergencyStopFlag(reason, order))


def _recovery_blocker(team: Coordinators, host: str, request: RecoverRequest) -> str:
    if team.is_halted:
        return f"{host} is stopping"
    if team.write_problem:
        return f"{host} cannot write its journal: {team.write_problem}"
    state = team.mobility.recoverable_state(request.agent)
    if state is None:
        return f"{host} has no copy of {request.agent} to resume, or it is alive there"
    if state.state == "RUN":
        return f"{request.agent} resumes by itself: {host} has just restarted"
    if state.state == "PREPARED":
        return f"{request.agent} is on its way from {host} to {state.where}"
    if (state.generation, state.sequence) != (request.generation, request.sequence):
        return f"the copy of {request.agent} on {host} has changed meanwhile; repeat the command"
    return ""


def wait_reason(team: Coordinators, machine: Machine, hosts: Sequence[str], agent: Agent) -> str:
    """A short text about what a frozen coordinator waits for: a write, or its departure."""
    if agent.unreachable_reason:
        return "cannot be there in time"
    if team.write_problem and team.write_ahead.is_pending_durable(agent.id):
        return "waits for its disk"
    if not team.is_departing(agent):
        return "persisting"
    called = machine.itinerary.current_target(agent) if machine.itinerary.is_fetching(agent) else None
    return f"fetches from {hosts[called[0].host]}" if called else "leaving"
