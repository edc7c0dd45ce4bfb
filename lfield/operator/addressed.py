"""Whom a command is about: each host once, of the runs on this computer or of a mission, and its address.

A host is asked at the socket of the run that runs it here, else where that run knows it. `--map` comes before
both. A mission that nobody runs here is asked at the addresses of its deployment.

What another user's run says of hosts takes none of these ways away: anybody can say it of any mission. Its
hosts are asked beside, and what they answer counts for that run alone. Who names it by `--run` believes it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from lfield.errors import NothingRuns, UsageError
from lfield.lang.deployment import read_deployment
from lfield.mission import bundle
from lfield.mission.team import Team, parse_maps, team_of
from lfield.operator.runs import Run, nothing_here
from lfield.text.suggest import listed
from lfield.text.visible import clipped, in_one_line


class Place(NamedTuple):
    """A host by its name, and its run; that is '' for a mission that nobody runs here.

    `user` is another one, on whose word alone there is such a run.
    """

    run: str
    host: str
    user: str = ""


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
    def user(self) -> str:
        """As of its runs: see `Run.user`."""
        return self.runs[0].user if self.runs else ""

    @property
    def mission(self) -> tuple[str, str]:
        """What it runs, and on whose word; '' for what nobody runs here, which is asked for alone."""
        return self.runs[0].note.deployment if self.runs else "", self.user

    @property
    def places(self) -> dict[Place, str]:
        """The addresses by who is there."""
        return {Place(self.id, host, self.user): address for host, address in self.addresses.items()}

    def takes(self, other: Party) -> bool:
        """Whether the other is of the same mission and has none of these hosts: both are one team."""
        return self.mission == other.mission and self.addresses.keys().isdisjoint(other.addresses)

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
    if any(not run.user for run in own):
        return parties_of(own, mapped)
    stated = team.at(mapped).reached
    taken = {(team.deployment.hex(), host, address) for host, address in stated.items()}
    return [Party((), stated), *_of_others(own, mapped, taken)]


#: A host of a deployment at an address, over a network.
_Known = tuple[str, str, str]


def parties_of(runs: Sequence[Run], mapped: Mapping[str, str] | None = None) -> list[Party]:
    """The teams of these runs. A host that is `mapped`, or that none of them runs, is in the first only."""
    mapped, taken = mapped or {}, set[_Known]()
    believed = _parties([run for run in runs if not run.user], mapped, taken)
    return believed + _of_others(runs, mapped, taken)


def _of_others(runs: Sequence[Run], mapped: Mapping[str, str], taken: Collection[_Known]) -> list[Party]:
    """The teams of other users, each by itself; over a network nobody is asked twice."""
    users = dict.fromkeys(run.user for run in runs if run.user)
    own = {user: [run for run in runs if run.user == user] for user in users}
    return [party for found in own.values() for party in _parties(found, mapped, set(taken))]


def _parties(runs: Sequence[Run], mapped: Mapping[str, str], taken: set[_Known]) -> list[Party]:
    """The teams of runs that believe each other; what is `taken` is asked elsewhere, and more is taken."""
    # What a run runs itself is asked there, also for another run that reaches it at its address.
    taken |= {
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
    """The run with that id, or the end of one; all of them for ''. Raises UsageError, NothingRuns.

    Another user may call a run as one is called that is believed.
    """
    found = [run for run in runs if not id or id in (run.id, run.folder.name, run.id.rpartition("-")[2])]
    if not id:
        return found
    if found:
        return [run for run in found if not run.is_foreign] or [replace(run, named=True) for run in found]
    if not runs:
        raise NothingRuns(f"no mission runs here that this user may see, and no run {id}: {nothing_here()}")
    raise UsageError(f"there is no run {id}: there is {listed([run.id for run in runs])}")


def believed_of(parties: Sequence[Party]) -> list[Party]:
    """Those that are there on nobody else's word; where there are none, all."""
    return [party for party in parties if not party.user] or list(parties)


def only_party(parties: Sequence[Party]) -> Party:
    """The one that is to be looked at; those of other users count where there is no other.

    Runs of one mission that run different hosts are one team, also where they name each other's hosts by
    different addresses (localhost and 127.0.0.1, say). Raises UsageError when there are several teams.
    """
    found = believed_of(parties)
    if len(found) > 1 and _is_one_team(found):
        return _joined(found)
    if len(found) > 1:
        runs = listed([party.id for party in found])
        raise UsageError(f"the mission runs here {len(found)} times, as {runs}: pick one with --run")
    return found[0]


def _is_one_team(parties: Sequence[Party]) -> bool:
    """Whether all these runs are of one mission and none of its hosts runs here twice."""
    hosts = [host for party in parties for run in party.runs for host in run.note.doors]
    return len({party.mission for party in parties}) == 1 and len(set(hosts)) == len(hosts)


def _joined(parties: Sequence[Party]) -> Party:
    """Several runs of a team as one, each host at the socket of the run that runs it here."""
    addresses: dict[str, str] = {}
    for party in reversed(parties):
        addresses |= party.addresses
    for party in parties:
        own = {host for run in party.runs for host in run.note.doors}
        addresses |= {host: address for host, address in party.addresses.items() if host in own}
    return Party(tuple(run for party in parties for run in party.runs), addresses)


def names_of(parties: Sequence[Party]) -> dict[Place, str]:
    """What each host is called: by its name alone where there is one party, else with its run before it."""
    places = [place for party in parties for place in party.places]
    alone = len(parties) == 1
    return {place: in_one_line(place.host if alone else f"{place.run}/{place.host}") for place in places}


def only_mission(runs: Sequence[Run]) -> Path:
    """The file of the one mission that runs. Raises UsageError when several do, or it has changed since.

    Also when only other users run any: what they name may be a fifo, say, and is not opened on their word.
    """
    believed = [run for run in runs if not run.is_foreign]
    if not believed:
        named = listed([f"{run.id} ({in_one_line(clipped(run.note.mission, 200))})" for run in runs[:8]])
        raise UsageError(f"only other users run missions here, name one with its file and --run: {named}")
    missions = {run.note.deployment: Path(run.note.mission) for run in believed}
    if len(missions) != 1:
        raise UsageError(f"several missions run here, name one: {listed(map(str, missions.values()))}")
    deployment, path = missions.popitem()
    if open_team(path).deployment.hex() != deployment:
        raise UsageError(f"{path} has changed since it was started: name the file of the mission that runs")
    return path
