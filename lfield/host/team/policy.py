"""Which devices of a host have lost their policy: no coordinator that used them is heard of any more. Pure.

A coordinator *uses* a device when a portal that it has called actuates it. From then on it is heard of

  - while a copy of it is here, or a host says that it has one;
  - while the host that it went to cannot be asked, but is heard by anybody: it may be there.

The host where the newest record leads is asked now and then, and tells where it went next. When that is of
no avail for half of the time, others are asked too. One that has ended is only one that is not heard of any
more: what it has left hovering gets the same time. A later start of it counts as the same.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Protocol

from msgspec import structs

from lfield.driver.binding import DeviceBinding
from lfield.host.effects import MakeSafe
from lfield.mobility.copies import LIVE
from lfield.mobility.effects import Send
from lfield.mobility.fates import Absent
from lfield.mobility.hearsay import LEAST
from lfield.wire.coordinators import Known
from lfield.wire.observing import StatusRequest

#: Seconds between two looks, while anything depends on them.
LOOK_EVERY = 1.0
#: So many hosts are asked at a time when the right one does not know.
ASKED_AT_ONCE = 8


class Links(Protocol):
    """What is known of the other hosts: `lfield.mobility.hearsay.Hearsay`."""

    @property
    def links(self) -> list[str]:
        """The hosts that can be asked."""

    def absent(self, answered: Container[str], now: float, lost_after: float, unmet: float) -> Absent:
        """The hosts that are not heard, by what is known of them."""


@dataclass(slots=True)
class _Coordinator:
    """What is known of one: when it was last seen alive, when last heard of, and the newest record of it."""

    seen: float
    heard: float
    newest: Known | None = None

    @property
    def where(self) -> str:
        """The host that it was last known to be on its way to, or on; '' for none."""
        return self.newest.where if self.newest is not None and not _is_over(self.newest) else ""

    def lives(self, now: float) -> None:
        """Somebody has it."""
        self.seen = self.heard = now

    def told(self, host: str, record: Known, now: float) -> None:
        """A host tells of it."""
        if record.state in LIVE:
            self.lives(now)
            record = structs.replace(record, where=host)
        if self.newest is None or _place(record) >= _place(self.newest):
            self.newest = record


class Policies:
    """The devices whose bindings say what becomes of them without a policy; all times are in seconds."""

    def __init__(self, devices: Iterable[DeviceBinding]) -> None:
        self._without = {device.name: device.without_policy for device in devices if device.without_policy}
        #: The devices that were used, by whom, and those coordinators.
        self._users: dict[str, set[str]] = {}
        self._coordinators: dict[str, _Coordinator] = {}
        self._turn = 0
        #: When `look` is due; None while no device depends on anybody.
        self.due: float | None = None

    def used(self, device: str, coordinator: str, now: float) -> None:
        """A portal that this coordinator has called actuates a device of this host."""
        if device not in self._without:
            return
        self._users.setdefault(device, set()).add(coordinator)
        self._coordinators.setdefault(coordinator, _Coordinator(now, now)).lives(now)
        self.due = now + LOOK_EVERY if self.due is None else self.due

    def told(self, host: str, records: Iterable[Known], now: float) -> None:
        """A host tells what it knows of coordinators."""
        for record in records:
            if record.agent in self._coordinators:
                self._coordinators[record.agent].told(host, record, now)

    def look(self, here: str, own: Iterable[Known], others: Links, now: float) -> list[MakeSafe | Send]:
        """Whom to ask, and what to make safe. `own` are the records of this host, which is `here`."""
        self.told(here, own, now)
        absent = others.absent((), now, LEAST, LEAST)
        asked: set[str] = set()
        for name, known in self._coordinators.items():
            where, can_be_asked = known.where, known.where in others.links
            if where in absent.elsewhere and not can_be_asked:
                known.heard = now
            patience = min(
                self._without[device].after for device in self._users if name in self._users[device]
            )
            if now - known.seen >= patience / 2.0:
                asked |= self._next(others.links)
            if now - known.seen >= patience / 4.0 and can_be_asked:
                asked.add(where)
        gone = [self._gone(device) for device in list(self._users) if self._is_gone(device, now)]
        self.due = now + LOOK_EVERY if self._users else None
        return [*gone, *(Send(host, StatusRequest()) for host in sorted(asked))]

    def _next(self, links: list[str]) -> set[str]:
        """Some hosts, and others the next time."""
        if not links:
            return set()
        first, self._turn = self._turn % len(links), self._turn + ASKED_AT_ONCE
        return set([*links[first:], *links[:first]][:ASKED_AT_ONCE])

    def _is_gone(self, device: str, now: float) -> bool:
        last = max(self._coordinators[name].heard for name in self._users[device])
        return now - last >= self._without[device].after

    def _gone(self, device: str) -> MakeSafe:
        """What becomes of a device: it depends on nobody then, until it is used again."""
        users, without = self._users.pop(device), self._without[device]
        told = ", ".join(self._in_words(name) for name in sorted(users))
        for name in users - set().union(*self._users.values()):
            del self._coordinators[name]
        reason = f"no coordinator that used it ({told}) has been heard of for {without.after:g} s"
        return MakeSafe(device, without.do, reason, tuple(sorted(users)))

    def _in_words(self, name: str) -> str:
        newest = self._coordinators[name].newest
        if newest is not None and _is_over(newest):
            return f"{name}, {newest.outcome}"
        return f"{name}, last known at {newest.where}" if newest and newest.where else name


def _is_over(record: Known) -> bool:
    """Whether it tells of an end. That something is lost is a presumption."""
    return record.state == "EXITED" and record.outcome != "lost"


def _place(record: Known) -> tuple[int, bool, int]:
    """How far on a coordinator's way a record is."""
    return record.generation, _is_over(record), record.sequence
