"""A single host with its core; the test sends all messages."""

from __future__ import annotations

import random
from collections.abc import Iterable

from lfield.replication.lease.core import Quorum
from lfield.replication.lease.effects import Checkpoint, Effect, SendQuorumMessage
from lfield.replication.lease.quorum_members import FencingTokens, QuorumMembers
from lfield.wire.coordinator_messages import CheckpointId, LeaseRecord, Locate, Located
from lfield.wire.quorum_messages import Heartbeat, HeartbeatAck, Propose

LEASE, INTERVAL = 2.0, 5.0


class One:
    """A host of a, b, c with its checkpoint of "Tour"; `now` is its clock."""

    def __init__(
        self,
        here: str = "a",
        saved: Checkpoint | None = None,
        fence: int = 0,
        members: str = "abc",
        *,
        new: bool = False,
    ) -> None:
        self.now, self.here, self.copy = 100.0, here, saved
        others = [name for name in "abc" if name != here]
        fences = FencingTokens({"Tour": fence} if fence else {})
        voters = QuorumMembers(members, here, LEASE, knows_promises=not new)
        self.core = Quorum(voters, others, ["Tour"], 77, self, fences, random.Random(1))
        self.core.start(self.now)

    def checkpoint(self, agent: str) -> Checkpoint | None:
        assert agent == "Tour", "the core asks for unknown agents"
        return self.copy

    def allocate_generation(self, agent: str, above: int) -> int:
        return (above // 65536 + 1) * 65536 + 1

    def on_message(self, host: str, message: object) -> list[Effect]:
        match message:
            case Locate():
                return [
                    SendQuorumMessage(
                        host, Located([], [], self.core.lease_records(message.agents, self.now))
                    )
                ]
            case LeaseRecord():
                return self.core.on_located(host, message, self.now)
        return self.core.on_message(host, message, self.now)  # type: ignore[arg-type]

    def pass_time(self, seconds: float) -> list[Effect]:
        """The effects of all ticks in this time."""
        effects: list[Effect] = []
        end = self.now + seconds
        while (due := self.core.due) is not None and due <= end:
            assert due > self.now - 1.0
            self.now = max(self.now, due)
            effects += self.core.tick(self.now)
        self.now = end
        return effects

    def lease(self) -> None:
        """b acknowledges a heartbeat of now."""
        beats = [heartbeat for _, heartbeat in messages_of(self.pass_time(0.6), Heartbeat)]
        self.on_message("b", HeartbeatAck(77, beats[-1].number, []))


def messages_of(effects: Iterable[Effect], kind: type) -> list[tuple[str, object]]:
    """The messages of a kind, and their receivers; an answer about locations counts as its records."""
    sent = [(e.host, e.message) for e in effects if isinstance(e, SendQuorumMessage)]
    flat = [
        (host, each)
        for host, message in sent
        for each in (message.leases if isinstance(message, Located) else [message])
    ]
    return [(host, each) for host, each in flat if isinstance(each, kind)]


def shadow(generation: int = 1, sequence: int = 3, interval: float = INTERVAL) -> Checkpoint:
    return Checkpoint(CheckpointId(generation, sequence, was_sent=True), is_alive=False, interval=interval)


def alive(generation: int = 1, sequence: int = 3) -> Checkpoint:
    return Checkpoint(CheckpointId(generation, sequence, was_sent=False), is_alive=True, interval=INTERVAL)


def proposed(effects: Iterable[Effect]) -> int:
    """The proposed generation; 0 if there is none."""
    return max((m.generation for _, m in messages_of(effects, Propose)), default=0)


def unknown() -> LeaseRecord:
    """The answer of a host without records."""
    return LeaseRecord("Tour", None)
