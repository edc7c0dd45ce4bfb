"""Where a coordinator is, from what hosts say of it. Pure."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from typing import TypeVar

from lfield.errors import CoordinatorAlive, LfieldError, UsageError
from lfield.wire.messages import Known, Status

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
    found = list(records(agent, answers))
    for place, known in found:
        if known.state in _LIVE:
            way = "" if known.state == "RUN" else f", on its way to {known.where}"
            raise CoordinatorAlive(
                f"{agent} is alive on {names[place]} (start {known.generation}){way}: nothing was done"
            )
    if any(known.state != "EXITED" for _, known in found) or _is_parked(agent, answers):
        return
    if not found:
        raise UsageError(f"no host that answers knows of a coordinator {agent}; 'lfield ps' shows them")
    last = max((known for _, known in found), key=lambda known: known.generation)
    raise UsageError(f"{agent} has ended on {last.where} ({last.outcome}): there is nothing to end")


def _is_parked(agent: str, answers: Mapping[K, Status | LfieldError]) -> bool:
    journals = [answer.journal for answer in answers.values() if not isinstance(answer, LfieldError)]
    return any(parked.agent == agent for journal in journals if journal for parked in journal.parked)
