"""Where a coordinator is, from what hosts say of it. Pure."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from typing import TypeVar

from lfield.errors import CoordinatorAlive, LfieldError, UsageError
from lfield.wire.coordinators import Known
from lfield.wire.observing import Status

K = TypeVar("K", bound=Hashable)

_LIVE = ("RUN", "FROZEN", "PREPARED")


def records(agent: str, answers: Mapping[K, Status | LfieldError]) -> Iterator[tuple[K, Known]]:
    """What each host that answered knows of an agent."""
    for place, answer in answers.items():
        if not isinstance(answer, LfieldError):
            yield from ((place, known) for known in answer.coordinators if known.agent == agent)


def insist_on_doubt(agent: str, answers: Mapping[K, Status | LfieldError], names: Mapping[K, str]) -> None:
    """Raises CoordinatorAlive when a host says that it has the coordinator, and UsageError when nothing of it
    is in doubt, lost or parked.
    """
    insist_on_none_alive(agent, answers, names)
    found = list(records(agent, answers))
    if any(known.state != "EXITED" for _, known in found) or _is_parked(agent, answers):
        return
    if not found:
        raise UsageError(f"no host that answers knows of a coordinator {agent}; 'lfield ps' shows them")
    last = max((known for _, known in found), key=lambda known: known.generation)
    raise UsageError(f"{agent} has ended on {last.where} ({last.outcome}): there is nothing to end")


def insist_on_none_alive(
    agent: str, answers: Mapping[K, Status | LfieldError], names: Mapping[K, str]
) -> None:
    """Raises CoordinatorAlive when a host says that it has the coordinator: where, and how it is there."""
    for place, known in records(agent, answers):
        if known.state in _LIVE:
            way = (
                f", {_state(agent, answers[place])}"
                if known.state == "RUN"
                else f", on its way to {known.where}"
            )
            raise CoordinatorAlive(
                f"{agent} is alive on {names[place]} (start {known.generation}){way}: nothing was done"
            )


def _state(agent: str, answer: Status | LfieldError) -> str:
    """A word for what it does there, as its host says."""
    agents = [] if isinstance(answer, LfieldError) else answer.agents
    return next((found.state for found in agents if found.id == agent), "not woken yet")


def _is_parked(agent: str, answers: Mapping[K, Status | LfieldError]) -> bool:
    journals = [answer.journal for answer in answers.values() if not isinstance(answer, LfieldError)]
    return any(parked.agent == agent for journal in journals if journal for parked in journal.parked)


def what_can_be_done(answers: Mapping[str, Status | LfieldError]) -> Iterator[str]:
    """A line for each coordinator that no host which answers has, and that has not ended."""
    told = {host: answer for host, answer in answers.items() if not isinstance(answer, LfieldError)}
    agents = {known.agent for status in told.values() for known in status.coordinators}
    agents |= {one.agent for status in told.values() if status.journal for one in status.journal.parked}
    for agent in sorted(agents):
        found = [known for _, known in records(agent, answers)]
        newest = max((known for known in found), key=_age, default=None)
        if any(known.state in _LIVE for known in found):
            continue
        if _is_parked(agent, answers):
            yield f"{agent}: start its own mission again, or end it: lfield forget {agent}"
        elif newest and newest.state in ("MOVED", "IN DOUBT"):
            away = newest.where and newest.where not in told
            first = f"start {newest.where} again; if that is gone for good, " if away else ""
            if any(k.state in ("MOVED", "IN DOUBT") and not k.unreadable for k in found):
                first += f"go on without it: lfield recover {agent}, or "
            yield f"{agent}: {first}end it: lfield forget {agent}"


def _age(known: Known) -> tuple[int, bool, int, int]:
    """What is newer is greater; an ending ends its start."""
    return known.generation, known.state == "EXITED", known.hops, known.sequence
