"""What a new start of the coordinators of one host waits for: the other hosts that the mission needs. Pure.

A coordinator that begins while a robot is missing, or while one runs another bundle, commands a team that its
program was not written for. So a new start waits until every host of the deployment that has resources is
linked. A host with another bundle cannot be linked, so it counts as missing. Hosts are left out by the
devices file (`start: {without: [...]}`) or by an operator's command (`lfield start --without HOST`).

A vehicle that is off the ground when a start would be new is one that an earlier start has left there: the
start is then held until an operator's command. The same holds after an emergency stop during the wait. A
vehicle that does not say where it is (its host has not opened it yet, say) is asked until it does, or until
an operator leaves its host out. The vehicles of a host that is left out count as long as that host is linked.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

from lfield.wire.fields import clip
from lfield.wire.observing import RefusedHost, StartStatus

#: Seconds until the wait is logged again: the first interval, and the longest; each is twice the last.
FIRST_REPEAT, LONGEST_REPEAT = 10.0, 300.0
#: Seconds between two lines at least, when what is waited for changes.
BETWEEN_LINES = 1.0
#: So many missing hosts are named in one line of the log, each with its reason.
MOST_NAMED = 8
#: Seconds until a host that has not answered is asked again for its vehicles.
ASK_AGAIN = 1.0

START = "'lfield start' starts the coordinators then"


class Refusal(NamedTuple):
    """Why no link with a host can be made, and which bundle it runs, b"" where that is not known."""

    reason: str
    bundle: bytes


class Readiness:
    """Whether the hosts that a new start needs are there.

    `needed` are the hosts with resources besides this one, in the order of the deployment, and `without`
    those that are left out. `vehicles` are the hosts, this one included, that have devices which can be off
    the ground. `is_linked` tells whether a host can be talked to now; times are in seconds of one clock.
    """

    def __init__(
        self,
        needed: Sequence[str],
        without: Collection[str],
        vehicles: Collection[str],
        is_linked: Callable[[str], bool],
    ) -> None:
        self._needed, self._vehicles, self._is_linked = needed, vehicles, is_linked
        self._without = set(without)
        #: Those of them that an operator has named.
        self._without_by_command: set[str] = set()
        #: The hosts that cannot be linked.
        self.refusals: dict[str, Refusal] = {}
        #: When each host lost its link before the start.
        self._lost: dict[str, float] = {}
        #: Why the start needs an operator's command, '' while it does not.
        self.held = ""
        #: When each host was asked for its vehicles, the hosts whose vehicles are all on the ground, and by
        #: host the vehicles that have not said whether they are.
        self._asked: dict[str, float] = {}
        self._on_ground: set[str] = set()
        self._unknown: dict[str, list[str]] = {}
        #: What was logged last, when, and when it is repeated.
        self._logged: object = None
        self._logged_at = self._repeat_at = 0.0
        self._interval = FIRST_REPEAT

    # --- events ---------------------------------------------------------------------------------------

    def on_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made, for that reason; '' when that is over."""
        self.refusals.pop(host, None)
        if reason:
            self.refusals[host] = Refusal(reason, bundle)

    def on_linked(self, host: str) -> None:
        """A host can be talked to."""
        self.refusals.pop(host, None)
        self._lost.pop(host, None)

    def on_unlinked(self, host: str, now: float) -> None:
        """A host cannot be talked to any more."""
        self._lost[host] = now
        # All are asked again then: it may take long until this one is back.
        self._ask_all_again()

    def on_vehicles(self, host: str, on_ground: Mapping[str, bool | None]) -> None:
        """A host says for each of its vehicles whether it is on the ground, None where that is not known."""
        if host not in self._asked:
            return
        self._unknown.pop(host, None)
        unknown = [vehicle for vehicle, landed in on_ground.items() if landed is None]
        if off_ground := [vehicle for vehicle, landed in on_ground.items() if landed is False]:
            self.hold(f"{' and '.join(off_ground)} of {host} {_is(off_ground)} off the ground: land first")
        elif unknown and host not in self._without_by_command:
            self._unknown[host] = unknown
        else:
            self._on_ground.add(host)

    def _ask_all_again(self) -> None:
        self._asked.clear()
        self._on_ground.clear()
        self._unknown.clear()

    def hold(self, reason: str) -> None:
        """The start needs an operator's command from now on."""
        self.held = self.held or reason

    def on_start_command(self, without: Collection[str]) -> None:
        """An operator wants the start, and does not want it to wait for some hosts."""
        self._without.update(without)
        self._without_by_command.update(without)
        self.held = ""
        self._ask_all_again()

    # --- questions ------------------------------------------------------------------------------------

    @property
    def without(self) -> list[str]:
        """The hosts that the start does not wait for."""
        return sorted(self._without)

    @property
    def missing(self) -> list[str]:
        """The hosts that have to be linked first, in the order of the deployment."""
        return [host for host in self._needed if host not in self._without and not self._is_linked(host)]

    @property
    def waited_for(self) -> list[str]:
        """The hosts that the start waits for: those that are missing, and those with vehicles of which it is
        not known whether they are on the ground."""
        missing = self.missing
        return [*missing, *(host for host in self._unsure() if host in self._unknown and host not in missing)]

    def to_ask(self, now: float) -> list[str]:
        """The hosts that are asked now for their vehicles, once all that are needed are linked."""
        due = [host for host in self._unsure() if now >= self._asked.get(host, now) + self._patience(host)]
        self._asked.update(dict.fromkeys(due, now))
        return due

    def _patience(self, host: str) -> float:
        return ASK_AGAIN if host in self._asked else 0.0

    def _unsure(self) -> list[str]:
        """The hosts of which it is not known whether their vehicles are on the ground.

        A host that is left out counts while it is linked: it may not be there at all.
        """
        unsure = [host for host in self._vehicles if host not in self._on_ground]
        return [host for host in unsure if host not in self._without or self._is_linked(host)]

    @property
    def is_ready(self) -> bool:
        """Whether a new start may be made now."""
        return not (self.held or self.missing or self._unsure())

    def status(self, agents: Sequence[str]) -> StartStatus:
        """What `lfield ps` shows of the wait of these coordinators."""
        return StartStatus(list(agents), self.waited_for, self.without, clip(self.held))

    @property
    def refused(self) -> list[RefusedHost]:
        """The hosts that cannot be linked, for whoever asks."""
        return [RefusedHost(h, clip(r.reason), r.bundle) for h, r in sorted(self.refusals.items())]

    def reasons(self, now: float) -> Mapping[str, str]:
        """Why the start waits for each of these hosts."""
        return {host: self._reason(host, now) for host in self.waited_for}

    def _reason(self, host: str, now: float) -> str:
        if host in self._unknown:
            vehicles = self._unknown[host]
            verb = "does" if len(vehicles) == 1 else "do"
            return f"{' and '.join(vehicles)} {verb} not say whether {_it(vehicles)} on the ground"
        if host in self.refusals:
            return f"refused: {self.refusals[host].reason}"
        if host in self._lost:
            return f"its link was lost {now - self._lost[host]:.0f} s ago"
        return "it has not been linked yet"

    # --- the log --------------------------------------------------------------------------------------

    @property
    def due(self) -> float | None:
        """When something is to be logged or asked again, None for never."""
        asked = [self._asked[host] + ASK_AGAIN for host in self._unsure() if host in self._asked]
        return min([self._repeat_at, *asked]) if self._repeat_at else min(asked, default=None)

    def line(self, agents: Sequence[str], now: float) -> str:
        """The line for the log about the wait of these coordinators, '' when none is due.

        It is due at once when what is waited for has changed, then again and again, ever more rarely.
        """
        now_waited_for = (self.held, tuple(self.waited_for), tuple(sorted(self.refusals)))
        is_news = now_waited_for != self._logged
        if is_news and self._logged is not None and now < self._logged_at + BETWEEN_LINES:
            self._repeat_at = self._logged_at + BETWEEN_LINES
            return ""
        if not is_news and now < self._repeat_at:
            return ""
        self._interval = FIRST_REPEAT if is_news else min(LONGEST_REPEAT, 2 * self._interval)
        self._logged, self._logged_at, self._repeat_at = now_waited_for, now, now + self._interval
        return self._sentence(agents, now)

    def _sentence(self, agents: Sequence[str], now: float) -> str:
        who = f"{' and '.join(agents)} {_is(agents)} not started"
        if self.held:
            return f"{who}: {self.held}; {START}"
        reasons = self.reasons(now)
        if not reasons:
            return ""
        named = [f"{host} ({reason})" for host, reason in list(reasons.items())[:MOST_NAMED]]
        more = f" and {len(reasons) - MOST_NAMED} more hosts" if len(reasons) > MOST_NAMED else ""
        options = " ".join(f"--without {host}" for host in list(reasons)[:MOST_NAMED])
        return (
            f"{who}: waiting for {', '.join(named)}{more}; start them, or let the mission begin without "
            f"them: 'lfield start {options}'"
        )


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _it(names: Sequence[str]) -> str:
    return "it is" if len(names) == 1 else "they are"
