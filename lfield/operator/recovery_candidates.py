"""Selects the host that can recover a coordinator after the permanent loss of its holder. Sans-IO."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct

from lfield.errors import CoordinatorAlive, UsageError
from lfield.operator.coordinator_location import parked_copies, records, require_no_live_copy
from lfield.operator.targets import HostRef
from lfield.operator.team_model.team_state import HostState
from lfield.wire.coordinator_messages import TERMINATED, CoordinatorState
from lfield.wire.observer_messages import RecoverRequest

_Hosts = Mapping[HostRef, HostState]


class RecoveryCandidate(Struct, frozen=True):
    """The host with the newest copy of a coordinator, and the request to it.

    `lines` are the evidence, for the confirmation by a person.
    """

    host_ref: HostRef
    request: RecoverRequest
    lines: Sequence[str]


def best_candidate(agent: str, hosts: _Hosts, names: Mapping[HostRef, str]) -> RecoveryCandidate:
    """The candidate to recover an agent, from the state of all hosts that answer.

    Raises CoordinatorAlive when a host runs the agent, also for another mission, and UsageError without a
    copy.
    """
    require_no_live_copy(agent, hosts, names)
    known_records = list(records(agent, hosts))
    _require_none_parked(agent, hosts, names)
    copies = [(place, record) for place, record in known_records if record.state in ("MOVED", "IN DOUBT")]
    ended = max((record.generation for _, record in known_records if record.outcome in TERMINATED), default=0)
    copies = [(place, record) for place, record in copies if record.generation > ended]
    if not copies:
        raise UsageError(_nothing_left(agent, known_records, hosts, names))
    if len({place.run for place, _ in copies}) > 1:
        raise UsageError(f"several runs here have a coordinator {agent}: name one with --run")
    copies.sort(key=lambda pair: (pair[1].generation, pair[1].hops, pair[1].sequence))
    readable = [n for n, (_, record) in enumerate(copies) if not record.unreadable]
    if not readable:
        where = ", ".join(names[place] for place, _ in copies)
        raise UsageError(f"the copy of {agent} on {where} cannot be read: it cannot be recovered")
    place, newest = copies[readable[-1]]
    above = max(record.generation for _, record in known_records)
    request = RecoverRequest(agent, newest.generation, newest.sequence, above)
    first, *more = _lines(place, newest, hosts, names)
    newer = [_newer(names[place], record) for place, record in copies[readable[-1] + 1 :]]
    return RecoveryCandidate(place, request, [first, *newer, *more])


def _newer(host: str, known: CoordinatorState) -> str:
    """The sentence about a newer copy that cannot be recovered."""
    return (
        f"  {host} has a newer one, of after {_hops(known)}, that cannot be read: what {known.agent} did in "
        "between may be done again"
    )


def _hops(known: CoordinatorState) -> str:
    return f"{known.hops} hop{'s' * (known.hops != 1)}"


def _require_none_parked(agent: str, hosts: _Hosts, names: Mapping[HostRef, str]) -> None:
    for place, copy in parked_copies(agent, hosts):
        if copy.state == "RUN":
            raise CoordinatorAlive(
                f"{names[place]} keeps {agent} for another mission ({copy.program.hex()[:16]}), and "
                f"continues it when that mission is started there; 'lfield forget {agent}' ends it"
            )


def _nothing_left(
    agent: str,
    known_records: Sequence[tuple[HostRef, CoordinatorState]],
    hosts: _Hosts,
    names: Mapping[HostRef, str],
) -> str:
    place, copy = next(parked_copies(agent, hosts), (None, None))
    if not known_records and place and copy:
        return (
            f"{agent} is of another mission ({copy.program.hex()[:16]}), for which {names[place]} keeps a "
            "copy: start that mission again to continue it"
        )
    if not known_records:
        return (
            f"no reachable host has a copy of coordinator {agent}: if it never left its home, the only copy "
            "is there, and continues when that host is started again"
        )
    last = max((record for _, record in known_records), key=lambda record: record.generation)
    return f"{agent} has ended on {last.where} ({last.outcome}): it cannot be recovered"


def _lines(
    place: HostRef, newest: CoordinatorState, hosts: _Hosts, names: Mapping[HostRef, str]
) -> list[str]:
    destination = place._replace(host=newest.where)
    lines = [
        f"{newest.agent}, start {newest.generation}: the newest copy is on {names[place]}, as it left for "
        f"{newest.where} after {_hops(newest)} (transfer {newest.sequence})"
    ]
    if newest.detail:
        lines.append(f"  {newest.detail}")
    lines += [f"  {line}" for host, line in _unreachable(hosts, names).items() if host.run == place.run]
    if destination in hosts and hosts[destination].linked:
        lines.append(f"  {names[destination]} answers, and does not have it")
    lines.append(
        f"  that call may have started; {newest.agent} loses its result and everything after it, and "
        "gets a RestartException"
    )
    return lines


def _unreachable(hosts: _Hosts, names: Mapping[HostRef, str]) -> dict[HostRef, str]:
    """A line for each host that does not answer, with the time since its last link."""
    lines: dict[HostRef, str] = {}
    linked = [host for host in hosts.values() if host.linked]
    for place in (place for place, host in hosts.items() if not host.linked):
        silences = (host.unreachable_for.get(place.host) for host in linked)
        silence = min((seconds for seconds in silences if seconds is not None), default=None)
        if any(place.host in host.links for host in linked):
            contact = "others are linked with it: it is up"
        else:
            contact = "no contact yet" if silence is None else f"last contact {silence:.0f} s ago"
        lines[place] = f"{names[place]} does not answer; {contact}"
    return lines
