"""Copies of coordinators on a host of the model, messages about them, and known terminations."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from lfield.replication.lease.effects import Checkpoint
from lfield.wire.coordinator_messages import CheckpointId, Terminated


class Transfer(NamedTuple):
    """A coordinator in transit."""

    agent: str
    generation: int
    sequence: int


class Inquire(NamedTuple):
    """A query whether a transfer has arrived."""

    agent: str
    generation: int
    sequence: int


class TransferVerdict(NamedTuple):
    """The verdict on a transfer: it has arrived (`accepted`), or it can no longer arrive."""

    agent: str
    generation: int
    sequence: int
    accepted: bool


@dataclass(frozen=True)
class Copy:
    """A copy of a coordinator on a host; `kept` once it is durable.

    `to` is the target of its departure, or the host of its termination.
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
    """The terminations that one life of host `here` knows."""

    def __init__(self, here: str, members: Collection[str]) -> None:
        self._here, self._members = here, frozenset(members)
        #: The newest terminated start of each coordinator, as received.
        self._received: dict[str, int] = {}
        #: The hosts that have confirmed the termination of each coordinator that terminated here.
        self._confirmed: dict[str, set[str]] = {}

    def note(self, message: object) -> None:
        """Record the terminations in a message."""
        told = message if isinstance(message, Terminated) else getattr(message, "ended", None)
        for ended in told if isinstance(told, list) else [told] if told else []:
            self._received[ended.agent] = max(ended.generation, self._received.get(ended.agent, 0))

    def confirmed_by(self, agent: str) -> set[str]:
        """The hosts that have confirmed a termination here."""
        return self._confirmed.setdefault(agent, set())

    def known(self, agent: str, copy: Copy | None) -> int:
        """The newest start that is known to have terminated; 0 for none. `copy` is the copy here."""
        here = copy.generation if copy and copy.state == "EXITED" else 0
        return max(here, self._received.get(agent, 0))

    def checkpoint(self, agent: str, copy: Copy) -> Checkpoint:
        """A termination for the core; until it is durable the coordinator counts as alive."""
        place = CheckpointId(copy.generation, copy.sequence, was_sent=False)
        if not copy.kept:
            return Checkpoint(place, is_alive=True, interval=0.0)
        known_by = self._members.intersection({self._here, *self.confirmed_by(agent)})
        final = copy.to != self._here or len(known_by) > len(self._members) // 2
        return Checkpoint(place, is_alive=False, interval=0.0, ended=copy.ended(agent), is_final=final)
