"""The missions whose bundles are active on robots, and their coordinators that do not run. Pure.

The data are the known states of the services.

An inventory may have more robots than a mission: only the hosts of the deployment in the active bundle count.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct

from lfield.wire.service_messages import BundleInfo, ServiceStatus


class ActiveMission(Struct, frozen=True):
    """A bundle and the hosts of its deployment; `coordinators` are its coordinators with their hosts."""

    digest: bytes
    name: str
    hosts: tuple[str, ...]
    coordinators: Mapping[str, str]


#: States of coordinators that run or will run; one that is in doubt may have ended elsewhere.
_RUNNING = ("running", "leaving", "waiting to start")
#: Phases in which a host does not run, and does not start by itself.
DOWN = ("stopped", "ended", "interrupted")


class IdleCoordinator(Struct, frozen=True):
    """A coordinator that does not run although hosts of its mission do, with the reason and the host."""

    agent: str
    host: str
    is_parked: bool

    @property
    def reason(self) -> str:
        """The reason why the coordinator does not run, and the remedy."""
        if self.is_parked:
            return (
                f"coordinator {self.agent} is parked: it belongs to another bundle; 'lfield stop --discard' "
                "ends it, and 'lfield start' then starts a new one"
            )
        return f"coordinator {self.agent} runs only when this host runs the mission: 'lfield start'"


def active_missions(
    statuses: Mapping[str, ServiceStatus], without: Collection[str] = ()
) -> list[ActiveMission]:
    """The missions whose bundles are active on all of their hosts that are in `statuses`.

    Hosts in `without` do not count, nor do missions that have no other host.
    """
    found = []
    for digest in dict.fromkeys(status.active for status in statuses.values()):
        mission = _mission(digest, statuses)
        counted = [host for host in mission.hosts if host not in without]
        if digest and counted and all(_has(statuses, host, digest) for host in counted):
            found.append(mission)
    return found


def divided_hosts(statuses: Mapping[str, ServiceStatus]) -> list[str]:
    """The hosts of a mission with different active bundles, in order; none if all missions are complete.

    A host that only has a bundle of an earlier mission, whose other hosts have a newer mission now, does not
    count, unless it runs that mission.
    """
    complete = {host for mission in active_missions(statuses) for host in mission.hosts}
    others = {host: status for host, status in statuses.items() if host not in complete}
    found: set[str] = set()
    for status in others.values():
        known = statuses if status.run.phase == "running" else others
        hosts = {host for host in _mission(status.active, statuses).hosts if status.active and host in known}
        found |= hosts if len(hosts) > 1 else set()
    return [host for host in statuses if host in found]


def idle_coordinators(mission: ActiveMission, statuses: Mapping[str, ServiceStatus]) -> list[IdleCoordinator]:
    """The coordinators that do not run on hosts that do: parked ones, and those of hosts that do not run.

    None without a running host, or where the mission of a host has ended in order: others may have ended.
    """
    known_statuses = {host: statuses[host] for host in mission.hosts if host in statuses}
    running = {host: status for host, status in known_statuses.items() if status.run.phase == "running"}
    if not running or any(
        status.run.phase == "ended" and status.run.status == 0 for status in known_statuses.values()
    ):
        return []
    coordinators = []
    for agent, home in mission.coordinators.items():
        states = [
            (host, coordinator.state)
            for host, status in running.items()
            for coordinator in status.unfinished
            if coordinator.agent == agent
        ]
        if states and all(state == "parked" for _, state in states):
            coordinators.append(IdleCoordinator(agent, states[0][0], is_parked=True))
        elif not states and (home not in known_statuses or known_statuses[home].run.phase in DOWN):
            coordinators.append(IdleCoordinator(agent, home, is_parked=False))
    return coordinators


def left_behind(mission: ActiveMission, statuses: Mapping[str, ServiceStatus]) -> list[str]:
    """The hosts that still run although the mission has ended on others.

    For example a host that was killed in the moment of the end: it waits for those that have ended.
    """
    known = [statuses[host] for host in mission.hosts if host in statuses]
    runs = any(coordinator.state in _RUNNING for status in known for coordinator in status.unfinished)
    if runs or not any(status.run.has_completed for status in known):
        return []
    return [status.host for status in known if status.run.phase == "running" and not status.run.reason]


def is_idle(mission: ActiveMission, idle: Collection[IdleCoordinator]) -> bool:
    """Whether no coordinator of a mission runs, so that no further event will happen."""
    return bool(idle) and len(idle) == len(mission.coordinators)


def idle_text(idle: Collection[IdleCoordinator], host: str) -> str:
    """The reasons of the idle coordinators of a host."""
    return "; ".join(coordinator.reason for coordinator in idle if coordinator.host == host)


def _has(statuses: Mapping[str, ServiceStatus], host: str, digest: bytes) -> bool:
    """Whether a bundle is active on a host, as far as is known."""
    return host not in statuses or statuses[host].active == digest


def _mission(digest: bytes, statuses: Mapping[str, ServiceStatus]) -> ActiveMission:
    info = bundle_info(statuses, digest)
    if info is None or not info.hosts:
        # The bundle is damaged, or its signature is not valid any more.
        having = tuple(host for host, status in statuses.items() if status.active == digest)
        return ActiveMission(digest, "", having, {})
    return ActiveMission(digest, info.name, tuple(info.hosts), info.coordinators)


def bundle_info(statuses: Mapping[str, ServiceStatus], digest: bytes) -> BundleInfo | None:
    """The description of a bundle that one of the hosts has stored."""
    infos = (info for status in statuses.values() for info in status.bundles)
    return next((info for info in infos if info.digest == digest), None)
