"""When a host may start its coordinators, and as which generation. Pure.

A generation tells a later start of a coordinator from an earlier one, so it must grow, whatever becomes of
clocks and disks. It is a counter (`generations`), above what this host has on record and what any other host
knows. One counter serves all coordinators of a host, since they are started together.

A host that has no record may have started them before all the same, with another disk. So it waits until it
has heard every other host, or is told that there was no earlier start.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from lfield.mobility.copies import LIVE
from lfield.mobility.generations import next_start
from lfield.wire.coordinators import Known


class Starts:
    """The starts of one host's coordinators; `agents` are those, `others` the other hosts of the team."""

    def __init__(self, agents: Collection[str], others: Collection[str]) -> None:
        self.agents = agents
        self._others, self._unheard = others, set(others)
        #: What the hosts that are linked said when they greeted.
        self._said: dict[str, list[Known]] = {}
        self._record: int | None = None
        self._newest = 0
        self._waiting = self._begun = False
        #: The hosts that need not be heard, by the devices file or an operator's command.
        self._without: set[str] = set()
        self._told = ""

    def heard(self, host: str, known: Iterable[Known] = ()) -> None:
        """A host has greeted; or it has ended for good, and knows nothing any more."""
        self._said[host] = list(known)
        self._unheard.discard(host)
        self.learn(self._said[host])

    def unlinked(self, host: str) -> None:
        """What a host said may have changed since."""
        self._said.pop(host, None)

    def learn(self, known: Iterable[Known]) -> None:
        """Starts that anybody knows of."""
        self._newest = max(self._newest, *(k.generation for k in known if k.agent in self.agents), 0)

    def beyond(self, generation: int) -> None:
        """No start up to this number may be made."""
        self._newest = max(self._newest, generation)

    def leave_out(self, hosts: Iterable[str]) -> None:
        """These need not be heard: an earlier start is not looked for there."""
        self._without.update(hosts)

    def begin(self, record: int | None, *, first: bool) -> None:
        """The others had time to answer. `record` is the last start on record here, None without one.

        `first`: somebody says that there was none.
        """
        self._record = 0 if record is None and first else record
        self._waiting = bool(self.agents)

    @property
    def is_waiting(self) -> bool:
        """Whether the others had time to answer, and nothing is started yet."""
        return self._waiting

    @property
    def due(self) -> bool:
        """Whether the coordinators are to be started now; once."""
        now = self._waiting and not self.missing
        self._waiting = self._waiting and not now
        self._begun = self._begun or now
        return now

    @property
    def begun(self) -> bool:
        """Whether they were to be started already; there may be none."""
        return self._begun or not self.agents

    @property
    def wanted(self) -> Collection[str]:
        """Who must be asked: all, until the coordinators are started; then those that were never heard.

        One of these may have an earlier start.
        """
        if not self.agents:
            return ()
        return self._unheard if self._begun else self._others

    @property
    def missing(self) -> list[str]:
        """The hosts that must be heard first."""
        return sorted(self._unheard - self._without) if self._record is None else []

    @property
    def unproven(self) -> list[str]:
        """The hosts left out and never heard on which an earlier start may be alive: there is no record."""
        return sorted(self._unheard & self._without) if self._record is None else []

    @property
    def next(self) -> int:
        """The generation of a start that is made now; no other host knows one as high."""
        return next_start(max(self._record or 0, self._newest))

    def why(self) -> str:
        """Why nothing is started yet, for the log: '' when there is nothing new to say."""
        if not (self._waiting and self.missing):
            return ""
        names, verb = " and ".join(sorted(self.agents)), "is" if len(self.agents) == 1 else "are"
        hosts, was = " and ".join(self.missing), "was" if len(self.missing) == 1 else "were"
        told, self._told = self._told, (
            f"{names} {verb} not started before {hosts} {was} heard: this host has no record of earlier "
            "starts; `--first-start` says that there was none"
        )  # fmt: skip
        return "" if told == self._told else self._told

    def parked(self, agent: str, known: Iterable[Known]) -> str:
        """The linked host where a coordinator waits for another mission, as it said; '' for none."""
        return self._where(agent, known, ("PARKED",))

    def shadowed(self, agent: str, known: Iterable[Known]) -> str:
        """The linked host where a coordinator has left its shadow, as it said; '' for none."""
        return self._where(agent, known, ("MOVED", "IN DOUBT"))

    def _where(self, agent: str, known: Iterable[Known], states: Collection[str]) -> str:
        ended = {k.generation for k in known if k.agent == agent and k.state == "EXITED"}
        for host, records in self._said.items():
            for record in records:
                if record.agent == agent and record.state in states and record.generation not in ended:
                    return host
        return ""

    def alive(self, agent: str, known: Iterable[Known]) -> bool:
        """Whether a coordinator is alive somewhere, by what is `known` here and what linked hosts said."""
        here = [record for record in known if record.agent == agent]
        ended = {record.generation for record in here if record.state == "EXITED"}
        said = (record for records in self._said.values() for record in records if record.agent == agent)
        return any(record.state in (*LIVE, "IN DOUBT") for record in here) or any(
            record.state in LIVE and record.generation not in ended for record in said
        )
