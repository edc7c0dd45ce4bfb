"""Which host could go on with a coordinator whose holder is gone for good, and what is believed. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from lfield.errors import CoordinatorAlive, LfieldError, UsageError
from lfield.operator.addressed import Place
from lfield.operator.whereabouts import insist_on_none_alive, records
from lfield.wire.coordinators import TERMINATED, Known
from lfield.wire.observing import ParkedStatus, Recover, Status

_Answers = Mapping[Place, Status | LfieldError]


@dataclass(frozen=True, slots=True)
class Belief:
    """Who has the newest copy of a coordinator, and what is told to that host.

    `lines` say what is believed, for a person who is asked.
    """

    place: Place
    word: Recover
    lines: Sequence[str]


def believed(agent: str, answers: _Answers, names: Mapping[Place, str]) -> Belief:
    """Who could go on with an agent, by what all hosts that can be reached say.

    Raises CoordinatorAlive when somebody has it, also for another mission, and UsageError when there is
    nothing to go on with.
    """
    insist_on_none_alive(agent, answers, names)
    found = list(records(agent, answers))
    _insist_on_none_parked(agent, answers, names)
    left = [(place, known) for place, known in found if known.state in ("MOVED", "IN DOUBT")]
    ended = max((known.generation for _, known in found if known.outcome in TERMINATED), default=0)
    left = [(place, known) for place, known in left if known.generation > ended]
    if not left:
        raise UsageError(_nothing_left(agent, found, answers, names))
    if len({place.run for place, _ in left}) > 1:
        raise UsageError(f"several runs here have a coordinator {agent}: name one with --run")
    left.sort(key=lambda pair: (pair[1].generation, pair[1].hops, pair[1].sequence))
    readable = [n for n, (_, known) in enumerate(left) if not known.unreadable]
    if not readable:
        where = ", ".join(names[place] for place, _ in left)
        raise UsageError(f"what {where} has kept of {agent} cannot be read: there is nothing to go on with")
    place, newest = left[readable[-1]]
    above = max(known.generation for _, known in found)
    word = Recover(agent, newest.generation, newest.sequence, above)
    first, *more = _lines(place, newest, answers, names)
    newer = [_newer(names[place], known) for place, known in left[readable[-1] + 1 :]]
    return Belief(place, word, [first, *newer, *more])


def _newer(host: str, known: Known) -> str:
    """What is said of a newer copy that nobody can go on with."""
    return (
        f"  {host} has a newer one, of after {_hops(known)}, that cannot be read: what {known.agent} did in "
        "between may be done again"
    )


def _hops(known: Known) -> str:
    return f"{known.hops} hop{'s' * (known.hops != 1)}"


def _parked(agent: str, answers: _Answers) -> Iterator[tuple[Place, ParkedStatus]]:
    """What hosts keep of an agent for another mission."""
    for place, answer in answers.items():
        journal = None if isinstance(answer, LfieldError) else answer.journal
        yield from ((place, one) for one in (journal.parked if journal else ()) if one.agent == agent)


def _insist_on_none_parked(agent: str, answers: _Answers, names: Mapping[Place, str]) -> None:
    for place, parked in _parked(agent, answers):
        if parked.state == "RUN":
            raise CoordinatorAlive(
                f"{names[place]} keeps {agent} for another mission ({parked.program.hex()[:16]}), and "
                f"goes on with it when that is started there; 'lfield forget {agent}' ends it"
            )


def _nothing_left(
    agent: str, found: Sequence[tuple[Place, Known]], answers: _Answers, names: Mapping[Place, str]
) -> str:
    place, parked = next(_parked(agent, answers), (None, None))
    if not found and place and parked:
        return (
            f"{agent} is of another mission ({parked.program.hex()[:16]}), for which {names[place]} keeps a "
            "copy: start that mission again to go on with it"
        )
    if not found:
        return (
            f"no host that answers knows of a coordinator {agent}: if there is one that never left its home, "
            "that has the only copy, and goes on with it when it is started again"
        )
    last = max((known for _, known in found), key=lambda known: known.generation)
    return f"{agent} has ended on {last.where} ({last.outcome}): there is nothing to go on with"


def _lines(place: Place, newest: Known, answers: _Answers, names: Mapping[Place, str]) -> list[str]:
    to = place._replace(host=newest.where)
    lines = [
        f"{newest.agent}, start {newest.generation}: the newest copy is on {names[place]}, as it left for "
        f"{newest.where} after {_hops(newest)} (transfer {newest.sequence})"
    ]
    if newest.detail:
        lines.append(f"  {newest.detail}")
    lines += [f"  {line}" for host, line in _silent(answers, names).items() if host.run == place.run]
    if not isinstance(answers.get(to), LfieldError) and to in answers:
        lines.append(f"  {names[to]} answers, and does not have it")
    lines.append(
        f"  the call that it left for may have begun; that, and all that {newest.agent} did after it, "
        "is lost to it, and it is told so"
    )
    return lines


def _silent(answers: _Answers, names: Mapping[Place, str]) -> dict[Place, str]:
    """A line for each host that does not answer: since when nobody who answers is linked with it."""
    lines: dict[Place, str] = {}
    for place in (place for place, answer in answers.items() if isinstance(answer, LfieldError)):
        told = [answer for answer in answers.values() if not isinstance(answer, LfieldError)]
        links = [link for status in told for link in status.links if link.host == place.host]
        away = min((link.away for link in links if link.away is not None), default=None)
        if any(link.away is None for link in links):
            heard = "others are linked with it: it is up"
        else:
            heard = "nobody has heard it" if away is None else f"last heard {away:.0f} s ago"
        lines[place] = f"{names[place]} does not answer; {heard}"
    return lines
