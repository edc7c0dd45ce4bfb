"""Resolves the targets of a command: the hosts of local runs or of a mission, deduplicated, with addresses.

The address of a host is, in this order: that of `--map`; the socket of a run on this computer; the address in
the note of such a run; those in the inventory; the address in the deployment.

Runs of other users are not trusted: anyone can claim any mission. Their hosts are queried separately, and the
answers count for that run only, unless the user names it with `--run`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from lfield.errors import NoMissionRunning, UsageError
from lfield.lang.deployment import read_deployment
from lfield.mission import bundle
from lfield.mission.team import Team, parse_maps, team_of
from lfield.operator.runs import Run, no_runs_hint
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line, truncate


class HostRef(NamedTuple):
    """A host and its run; '' for a mission without a run on this computer.

    `user` is the owner of a run of another user, '' for a trusted run.
    """

    run: str
    host: str
    user: str = ""


class TargetTeam(Struct, frozen=True):
    """The hosts of one team with the addresses of requests, and their runs on this computer.

    A team without a run is a mission elsewhere, or all hosts of the inventory.
    """

    runs: tuple[Run, ...]
    addresses: Mapping[str, str]

    @property
    def id(self) -> str:
        """The id of the first run."""
        return self.runs[0].id if self.runs else ""

    @property
    def user(self) -> str:
        """The `Run.user` of the team's runs."""
        return self.runs[0].user if self.runs else ""

    @property
    def mission(self) -> tuple[str, str]:
        """The deployment and the user; '' for a mission without a run on this computer."""
        return self.runs[0].manifest.deployment if self.runs else "", self.user

    @property
    def host_refs(self) -> dict[HostRef, str]:
        """The addresses by host."""
        return {HostRef(self.id, host, self.user): address for host, address in self.addresses.items()}

    def can_join(self, other: TargetTeam) -> bool:
        """Whether both are one team: the same mission, and no host in common."""
        return self.mission == other.mission and self.addresses.keys().isdisjoint(other.addresses)

    def joined_with(self, other: TargetTeam) -> TargetTeam:
        """Both teams as one, in the order of the deployment."""
        both = {**self.addresses, **other.addresses}
        order = [host for host in self.runs[0].manifest.addresses if host in both]
        return TargetTeam(
            (*self.runs, *other.runs), {host: both[host] for host in dict.fromkeys((*order, *both))}
        )


def open_team(mission: Path) -> Team:
    """The team of a bundle, or of a deployment without its program: then without the kinds of agents.

    Raises InputFileError, and BundleError or ProgramError for a file with mistakes.
    """
    if mission.suffix == bundle.SUFFIX:
        return bundle.read(mission).team
    deployment = read_deployment(mission, None)
    return team_of(deployment.rows, deployment.kinds, deployment.ports)


def targets_of_team(
    team: Team,
    runs: Sequence[Run],
    maps: Sequence[str],
    inventory: Callable[[], Mapping[str, str]] = dict,
) -> list[TargetTeam]:
    """The runs of a team, else the team at its own addresses; `maps` are `NAME=ADDR:PORT`.

    `inventory` returns the addresses of hosts in the inventory. Raises UsageError.
    """
    mapped = parse_maps(maps, team)
    own = [run for run in runs if run.manifest.deployment == team.deployment.hex()]
    if any(not run.user for run in own):
        return targets_of_runs(own, mapped)
    stated = team.at({**inventory(), **mapped}).addresses_by_host
    claimed = {(team.deployment.hex(), host, address) for host, address in stated.items()}
    return [TargetTeam((), stated), *_foreign_targets(own, mapped, claimed)]


#: A host of a deployment at an address, over a network.
_MissionKey = tuple[str, str, str]


def targets_of_runs(runs: Sequence[Run], mapped: Mapping[str, str] | None = None) -> list[TargetTeam]:
    """The teams of these runs. A host that is `mapped`, or that none of them runs, is in the first only."""
    mapped, claimed = mapped or {}, set[_MissionKey]()
    believed = _trusted_targets([run for run in runs if not run.user], mapped, claimed)
    return believed + _foreign_targets(runs, mapped, claimed)


def _foreign_targets(
    runs: Sequence[Run], mapped: Mapping[str, str], claimed: Collection[_MissionKey]
) -> list[TargetTeam]:
    """The teams of other users; no network address occurs twice."""
    users = dict.fromkeys(run.user for run in runs if run.user)
    own = {user: [run for run in runs if run.user == user] for user in users}
    return [target for found in own.values() for target in _trusted_targets(found, mapped, set(claimed))]


def _trusted_targets(
    runs: Sequence[Run], mapped: Mapping[str, str], claimed: set[_MissionKey]
) -> list[TargetTeam]:
    """The teams of runs of one user, without the `claimed` hosts; adds its own to `claimed`."""
    # A host with a local socket is queried there, also for another run that has its network address.
    claimed |= {
        (run.manifest.deployment, host, run.manifest.addresses.get(host, ""))
        for run in runs
        for host in run.manifest.control_sockets
        if host not in mapped
    }
    targets: list[TargetTeam] = []
    for run in runs:
        addresses = {}
        for host, known in run.manifest.addresses.items():
            socket = "" if host in mapped else run.control_socket(host)
            address = mapped.get(host, known)
            if socket or (run.manifest.deployment, host, address) not in claimed:
                addresses[host] = socket or address
                claimed.add((run.manifest.deployment, host, address))
        _merge_into(TargetTeam((run,), addresses), targets)
    return [target for target in targets if target.addresses]


def _merge_into(target: TargetTeam, targets: list[TargetTeam]) -> None:
    for number, other in enumerate(targets):
        if other.can_join(target):
            targets[number] = other.joined_with(target)
            return
    targets.append(target)


def select_runs(runs: Sequence[Run], id: str) -> list[Run]:
    """The run with that id, or suffix of an id; all for ''. Raises UsageError, NoMissionRunning.

    Another user may give a run the same name as a trusted run.
    """
    found = [run for run in runs if not id or id in (run.id, run.folder.name, run.id.rpartition("-")[2])]
    if not id:
        return found
    if found:
        return [run for run in found if not run.is_foreign] or [replace(run, named=True) for run in found]
    if not runs:
        raise NoMissionRunning(f"no run {id}: no mission is running on this computer: {no_runs_hint()}")
    raise UsageError(f"there is no run {id}; running: {listed([run.id for run in runs])}")


def trusted_targets(targets: Sequence[TargetTeam]) -> list[TargetTeam]:
    """The teams of trusted runs; all if there is none."""
    return [target for target in targets if not target.user] or list(targets)


def single_target(targets: Sequence[TargetTeam]) -> TargetTeam:
    """The only team; those of other users count only without a trusted one.

    Runs of one mission that run different hosts are one team, also where they name each other's hosts by
    different addresses (localhost and 127.0.0.1, say). Raises UsageError when there are several teams.
    """
    found = trusted_targets(targets)
    if len(found) > 1 and _are_one_team(found):
        return _merged(found)
    if len(found) > 1:
        runs = listed([target.id for target in found])
        raise UsageError(f"the mission runs here {len(found)} times, as {runs}: pick one with --run")
    return found[0]


def _are_one_team(targets: Sequence[TargetTeam]) -> bool:
    """Whether all runs are of one mission, and no host runs twice."""
    hosts = [host for target in targets for run in target.runs for host in run.manifest.control_sockets]
    return len({target.mission for target in targets}) == 1 and len(set(hosts)) == len(hosts)


def _merged(targets: Sequence[TargetTeam]) -> TargetTeam:
    """The runs of a team as one, each host at the control socket of its run."""
    addresses: dict[str, str] = {}
    for target in reversed(targets):
        addresses |= target.addresses
    for target in targets:
        own = {host for run in target.runs for host in run.manifest.control_sockets}
        addresses |= {host: address for host, address in target.addresses.items() if host in own}
    return TargetTeam(tuple(run for target in targets for run in target.runs), addresses)


def display_names(targets: Sequence[TargetTeam]) -> dict[HostRef, str]:
    """The display name of each host: its name, with its run in front when there are several teams."""
    places = [place for target in targets for place in target.host_refs]
    alone = len(targets) == 1
    return {
        place: escape_line(place.host if alone or not place.run else f"{place.run}/{place.host}")
        for place in places
    }


def running_mission(runs: Sequence[Run]) -> Path:
    """The file of the only running mission. Raises UsageError for several, or when the file has changed, and
    NoMissionRunning for none.

    Runs of other users do not count: the file that they name may be a FIFO, and is not opened.
    """
    believed = [run for run in runs if not run.is_foreign]
    if not runs:
        raise NoMissionRunning("no mission is running on this computer: name the file of the mission")
    if not believed:
        named = listed([f"{run.id} ({escape_line(truncate(run.manifest.mission, 200))})" for run in runs[:8]])
        raise UsageError(f"only other users run missions here, name one with its file and --run: {named}")
    missions = {run.manifest.deployment: Path(run.manifest.mission) for run in believed}
    if len(missions) != 1:
        raise UsageError(f"several missions run here, name one: {listed(map(str, missions.values()))}")
    deployment, path = missions.popitem()
    if open_team(path).deployment.hex() != deployment:
        raise UsageError(f"{path} has changed since it was started: name the file of the mission that runs")
    return path
