"""Readiness for a new start of one host's coordinators: waits for the other hosts of the mission. Sans-IO.

A coordinator that starts while a robot is missing, or runs another bundle, commands a team that its program
was not written for. So a new start waits until every host of the deployment with resources is linked. A host
with another bundle cannot be linked, so it counts as missing. Hosts are excluded by the devices file
(`start: {without: [...]}`) or by an operator's command (`lfield start --without HOST`).

A vehicle in the air at a new start was left there by an earlier start: the new start is then held until an
operator's command. The same applies after an emergency stop during the wait. A vehicle that does not report
whether it is on the ground (perhaps its host has not opened it yet) is queried until it reports, or until an
operator excludes its host. The vehicles of an excluded host count as long as that host is linked.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.fields import truncate
from lfield.wire.observer_messages import StartStatus, UnlinkableHost

#: Seconds until the wait is logged again: the first interval, and the longest; each interval is twice the
#: last one.
FIRST_REPEAT, LONGEST_REPEAT = 10.0, 300.0
#: Minimum seconds between two lines when the missing hosts change.
LOG_INTERVAL = 1.0
#: The most missing hosts named in one log line, each with its reason.
MAX_NAMED = 8
#: Seconds until a host that has not answered is queried again for its vehicles.
QUERY_EVERY = 1.0


class LinkRefusal(NamedTuple):
    """The reason why no link with a host can be made, and the bundle of that host, b"" if unknown."""

    reason: str
    bundle: bytes


class Readiness:
    """Whether the hosts that a new start needs are present.

    `own_host` is this host. `needed` are the hosts with resources, in the order of the deployment, and
    `without` the excluded hosts. `vehicles` are the hosts, this one included, with devices that can be
    in the air. `is_linked` returns whether a host is linked now; times are in seconds of one clock.
    """

    def __init__(
        self,
        own_host: str,
        needed: Sequence[str],
        without: Collection[str],
        vehicles: Collection[str],
        is_linked: Callable[[str], bool],
    ) -> None:
        self._own_host, self._needed, self._vehicles, self._is_linked = own_host, needed, vehicles, is_linked
        self._without = set(without)
        #: The hosts excluded by an operator.
        self._without_by_command: set[str] = set()
        #: The hosts that cannot be linked.
        self.refusals: dict[str, LinkRefusal] = {}
        #: The time when each host lost its link before the start.
        self._lost: dict[str, float] = {}
        #: The reason why the start needs an operator's command, '' if it does not.
        self.held = ""
        #: The time when each host was queried for its vehicles; the hosts whose vehicles are all on the
        #: ground; and by host the vehicles that have not reported whether they are.
        self._queried_at: dict[str, float] = {}
        self._on_ground: set[str] = set()
        self._unknown: dict[str, list[str]] = {}
        #: The last log line, when it was written, and when it is repeated.
        self._logged: object = None
        self._logged_at = self._repeat_at = 0.0
        self._interval = FIRST_REPEAT

    # --- events ---------------------------------------------------------------------------------------

    def on_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made, for that reason; '' when a link is possible again."""
        self.refusals.pop(host, None)
        if reason:
            self.refusals[host] = LinkRefusal(reason, bundle)

    def on_linked(self, host: str) -> None:
        """A link with a host opened."""
        self.refusals.pop(host, None)
        self._lost.pop(host, None)

    def on_unlinked(self, host: str, now: float) -> None:
        """A link with a host closed."""
        self._lost[host] = now
        # All hosts are queried again then: this one may be absent for long.
        self._query_all_again()

    def on_vehicles(self, host: str, on_ground: Mapping[str, bool | None]) -> None:
        """A host reports for each of its vehicles whether it is on the ground, None if unknown."""
        if host not in self._queried_at:
            return
        self._unknown.pop(host, None)
        unknown = [vehicle for vehicle, landed in on_ground.items() if landed is None]
        if off_ground := [vehicle for vehicle, landed in on_ground.items() if landed is False]:
            verb = "is" if len(off_ground) == 1 else "are"
            self.hold(f"{' and '.join(off_ground)} of {host} {verb} off the ground: land first")
        elif unknown and host not in self._without_by_command:
            self._unknown[host] = unknown
        else:
            self._on_ground.add(host)

    def _query_all_again(self) -> None:
        self._queried_at.clear()
        self._on_ground.clear()
        self._unknown.clear()

    def hold(self, reason: str) -> None:
        """Hold the start until an operator's command."""
        self.held = self.held or reason

    def on_start_command(self, without: Collection[str]) -> None:
        """An operator orders the start, and excludes some hosts."""
        self._without.update(without)
        self._without_by_command.update(without)
        self.held = ""
        self._query_all_again()

    # --- queries --------------------------------------------------------------------------------------

    @property
    def without(self) -> list[str]:
        """The hosts that the start does not wait for."""
        return sorted(self._without)

    @property
    def missing(self) -> list[str]:
        """The hosts that have to be linked first, in the order of the deployment."""
        others = (host for host in self._needed if host != self._own_host)
        return [host for host in others if host not in self._without and not self._is_linked(host)]

    @property
    def waited_for(self) -> list[str]:
        """The hosts that the start waits for: missing hosts, and hosts of vehicles that may fly."""
        missing = self.missing
        return [
            *missing,
            *(host for host in self._unknown_hosts() if host in self._unknown and host not in missing),
        ]

    def hosts_to_query(self, now: float) -> list[str]:
        """The hosts to query for their vehicles now, once all needed ones are linked."""
        due = [
            host
            for host in self._unknown_hosts()
            if now >= self._queried_at.get(host, now) + self._timeout(host)
        ]
        self._queried_at.update(dict.fromkeys(due, now))
        return due

    def _timeout(self, host: str) -> float:
        return QUERY_EVERY if host in self._queried_at else 0.0

    def _unknown_hosts(self) -> list[str]:
        """The hosts whose vehicles may be in the air.

        An excluded host counts only while it is linked: it may not exist.
        """
        unsure = [host for host in self._vehicles if host not in self._on_ground]
        return [host for host in unsure if host not in self._without or self._is_linked(host)]

    @property
    def is_ready(self) -> bool:
        """Whether a new start may be made now."""
        return not (self.held or self.missing or self._unknown_hosts())

    def status(self, agents: Sequence[str]) -> StartStatus:
        """The status of the wait of these coordinators, for `lfield ps`."""
        return StartStatus(list(agents), self.waited_for, self.without, truncate(self.held))

    @property
    def refused(self) -> list[UnlinkableHost]:
        """The hosts that cannot be linked."""
        return [UnlinkableHost(h, truncate(r.reason), r.bundle) for h, r in sorted(self.refusals.items())]

    def reasons(self, now: float) -> Mapping[str, str]:
        """The reasons why the start waits for each of these hosts."""
        return {host: self._reason(host, now) for host in self.waited_for}

    def _reason(self, host: str, now: float) -> str:
        if host in self._unknown:
            vehicles = self._unknown[host]
            verb = "has" if len(vehicles) == 1 else "have"
            return (
                f"{' and '.join(vehicles)} {verb} not reported whether {_it_or_they(vehicles)} on the ground"
            )
        if host in self.refusals:
            return f"refused: {self.refusals[host].reason}"
        if host in self._lost:
            return f"its link was lost {now - self._lost[host]:.0f} s ago"
        return "no link yet"

    # --- the log --------------------------------------------------------------------------------------

    @property
    def due(self) -> float | None:
        """The time of the next log line or query, None for never."""
        query_times = [
            self._queried_at[host] + QUERY_EVERY for host in self._unknown_hosts() if host in self._queried_at
        ]
        return min([self._repeat_at, *query_times]) if self._repeat_at else min(query_times, default=None)

    def line(self, agents: Sequence[str], now: float) -> LogLine | None:
        """The log line about the wait of these coordinators, None when none is due.

        A line is due at once when the missing hosts have changed, then at increasing intervals.
        """
        now_waited_for = (self.held, tuple(self.waited_for), tuple(sorted(self.refusals)))
        is_changed = now_waited_for != self._logged
        if is_changed and self._logged is not None and now < self._logged_at + LOG_INTERVAL:
            self._repeat_at = self._logged_at + LOG_INTERVAL
            return None
        if not is_changed and now < self._repeat_at:
            return None
        self._interval = FIRST_REPEAT if is_changed else min(LONGEST_REPEAT, 2 * self._interval)
        self._logged, self._logged_at, self._repeat_at = now_waited_for, now, now + self._interval
        return self._wait_line(" and ".join(agents), now)

    def _wait_line(self, agents: str, now: float) -> LogLine | None:
        if self.held:
            return log_messages.START_HELD.line(agents=agents, reason=self.held)
        reasons = self.reasons(now)
        if not reasons:
            return None
        named = [f"{host} ({reason})" for host, reason in list(reasons.items())[:MAX_NAMED]]
        more = f" and {len(reasons) - MAX_NAMED} more hosts" if len(reasons) > MAX_NAMED else ""
        options = " ".join(f"--without {host}" for host in list(reasons)[:MAX_NAMED])
        return log_messages.START_WAIT.line(agents=agents, hosts=f"{', '.join(named)}{more}", options=options)


def _it_or_they(names: Sequence[str]) -> str:
    return "it is" if len(names) == 1 else "they are"
