"""Whom a command is about: each host once, of the runs on this computer or of a mission, and its address.

A host is asked at the socket of the run that runs it here, else where that run knows it. `--map` comes before
both. A mission that nobody runs here is asked at the addresses of its deployment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from lfield.errors import NothingRuns, UsageError
from lfield.lang.deployment import read_deployment
from lfield.mission import bundle
from lfield.mission.team import Team, parse_maps, team_of
from lfield.operator.runs import Run, nothing_here
from lfield.text.suggest import listed


class Place(NamedTuple):
    """A host by its name, and its run; that is '' for a mission that nobody runs here."""

    run: str
    host: str


@dataclass(frozen=True, slots=True)
class Party:
    """Hosts that belong together, each with the address where it is asked, and their runs here."""

    runs: tuple[Run, ...]
    addresses: Mapping[str, str]

    @property
    def id(self) -> str:
        """What it is called: as the first of its runs."""
        return self.runs[0].id if self.runs else ""

    @property
    def places(self) -> dict[Place, str]:
        """The addresses by who is there."""
        return {Place(self.id, host): address for host, address in self.addresses.items()}

    def takes(self, other: Party) -> bool:
        """Whether the other is of the same mission and has none of these hosts: both are one team."""
        same = self.runs[0].note.deployment == other.runs[0].note.deployment
        return same and self.addresses.keys().isdisjoint(other.addresses)

    def with_(self, other: Party) -> Party:
        """Both as one, in the order of the team."""
        both = {**self.addresses, **other.addresses}
        order = [host for host in self.runs[0].note.addresses if host in both]
        return Party((*self.runs, *other.runs), {host: both[host] for host in dict.fromkeys((*order, *both))})


def open_team(mission: Path) -> Team:
    """The team of a bundle, or of a deployment, whose program is not looked at: no kinds are known then.

    Raises InputFileError, and BundleError or ProgramError for a file with mistakes.
    """
    if mission.suffix == bundle.SUFFIX:
        return bundle.read(mission).team
    deployment = read_deployment(mission, None)
    return team_of(deployment.rows, deployment.kinds, deployment.ports)


def parties_of_team(team: Team, runs: Sequence[Run], maps: Sequence[str]) -> list[Party]:
    """The runs of a team among these, else the team where it says; `maps` are `NAME=ADDR:PORT`.

    Raises UsageError.
    """
    mapped = parse_maps(maps, team)
    own = [run for run in runs if run.note.deployment == team.deployment.hex()]
    return parties_of(own, mapped) if own else [Party((), team.at(mapped).reached)]


def parties_of(runs: Sequence[Run], mapped: Mapping[str, str] | None = None) -> list[Party]:
    """The teams of these runs. A host that is `mapped`, or that none of them runs, is in the first only."""
    mapped = mapped or {}
    # What a run runs itself is asked there, also for another run that reaches it at its address.
    taken = {
        (run.note.deployment, host, run.note.addresses.get(host, ""))
        for run in runs
        for host in run.note.doors
        if host not in mapped
    }
    parties: list[Party] = []
    for run in runs:
        addresses = {}
        for host, known in run.note.addresses.items():
            door = "" if host in mapped else run.door(host)
            address = mapped.get(host, known)
            if door or (run.note.deployment, host, address) not in taken:
                addresses[host] = door or address
                taken.add((run.note.deployment, host, address))
        _join(Party((run,), addresses), parties)
    return [party for party in parties if party.addresses]


def _join(party: Party, parties: list[Party]) -> None:
    for number, other in enumerate(parties):
        if other.takes(party):
            parties[number] = other.with_(party)
            return
    parties.append(party)


def picked(runs: Sequence[Run], id: str) -> list[Run]:
    """The run with that id, or the end of one; all of them for ''. Raises UsageError, NothingRuns."""
    found = [run for run in runs if not id or id in (run.id, run.id.rpartition("-")[2])]
    if found or not id:
        return found
    if not runs:
        raise NothingRuns(f"no mission runs here that this user may see, and no run {id}: {nothing_here()}")
    raise UsageError(f"there is no run {id}: there is {listed([run.id for run in runs])}")


def names_of(parties: Sequence[Party]) -> dict[Place, str]:
    """What each host is called: by its name alone where there is one party, else with its run before it."""
    places = [place for party in parties for place in party.places]
    return {place: place.host if len(parties) == 1 else f"{place.run}/{place.host}" for place in places}


def only_mission(runs: Sequence[Run]) -> Path:
    """The file of the one mission that runs. Raises UsageError when several do, or it has changed since."""
    missions = {run.note.deployment: Path(run.note.mission) for run in runs}
    if len(missions) != 1:
        raise UsageError(f"several missions run here, name one: {listed(map(str, missions.values()))}")
    deployment, path = missions.popitem()
    if open_team(path).deployment.hex() != deployment:
        raise UsageError(f"{path} has changed since it was started: name the file of the mission that runs")
    return path
