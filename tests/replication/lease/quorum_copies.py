"""What a host of the model has of coordinators, what it says of them, and what it knows of terminations."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from lfield.replication.lease.effects import Checkpoint
from lfield.wire.coordinator_messages import CheckpointId, Terminated


class Transfer(NamedTuple):
    """A coordinator, under way."""

    agent: str
    generation: int
    sequence: int


class Inquire(NamedTuple):
    """Did this transfer arrive?"""

    agent: str
    generation: int
    sequence: int


class TransferVerdict(NamedTuple):
    """It did, or it never will."""

    agent: str
    generation: int
    sequence: int
    accepted: bool


@dataclass(frozen=True)
class Copy:
    """What a host has of a coordinator; `kept` once that is on its disk.

    `to` is the host that it leaves for, or where it has terminated.
    """

    generation: int
    sequence: int
    state: str
    to: str = ""
    kept: bool = False

    def ended(self, agent: str) -> Terminated:
        """The message about its termination."""
        return Terminated(agent, self.generation, "done", "", self.to)


class Ends:
    """What one life of host `here` knows of terminations."""

    def __init__(self, here: str, members: Collection[str]) -> None:
        self._here, self._members = here, frozenset(members)
        #: The newest start of each coordinator of whose termination a message has come.
        self._received: dict[str, int] = {}
        #: The hosts that have confirmed the termination of each coordinator that terminated here.
        self._confirmed: dict[str, set[str]] = {}

    def note(self, message: object) -> None:
        """A message may tell of terminations."""
        told = message if isinstance(message, Terminated) else getattr(message, "ended", None)
        for ended in told if isinstance(told, list) else [told] if told else []:
            self._received[ended.agent] = max(ended.generation, self._received.get(ended.agent, 0))

    def confirmed_by(self, agent: str) -> set[str]:
        """The hosts that have confirmed a termination here."""
        return self._confirmed.setdefault(agent, set())

    def known(self, agent: str, copy: Copy | None) -> int:
        """The newest start of it that is known to have terminated; 0 for none. `copy` is what is here."""
        here = copy.generation if copy and copy.state == "EXITED" else 0
        return max(here, self._received.get(agent, 0))

    def checkpoint(self, agent: str, copy: Copy) -> Checkpoint:
        """A termination for the core; until it is on disk the coordinator counts as alive."""
        place = CheckpointId(copy.generation, copy.sequence, was_sent=False)
        if not copy.kept:
            return Checkpoint(place, is_alive=True, interval=0.0)
        known_by = self._members.intersection({self._here, *self.confirmed_by(agent)})
        final = copy.to != self._here or len(known_by) > len(self._members) // 2
        return Checkpoint(place, is_alive=False, interval=0.0, ended=copy.ended(agent), is_final=final)
