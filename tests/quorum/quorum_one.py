"""One host alone with its core, for tests that say everything that it hears."""

from __future__ import annotations

import random
from collections.abc import Iterable

from lfield.quorum.core import Quorum
from lfield.quorum.effects import Effect, Saved, Tell
from lfield.quorum.members import Members
from lfield.wire.quorum import Ack, Heartbeat, Place, Propose, Sought

LEASE, INTERVAL = 2.0, 5.0


class One:
    """A host of a, b, c with what it has of "Tour"; `now` is its clock."""

    def __init__(
        self,
        here: str = "a",
        saved: Saved | None = None,
        fence: int = 0,
        members: str = "abc",
        *,
        new: bool = False,
    ) -> None:
        self.now, self.here, self.copy = 100.0, here, saved
        others = [name for name in "abc" if name != here]
        fences = {"Tour": fence, "Gone": 7} if fence else {}
        given = Members(members, here, LEASE), others, ["Tour"], 77, self, fences, random.Random(1)
        self.core = Quorum(*given, new=new)
        self.core.begin(self.now)

    def saved(self, agent: str) -> Saved | None:
        assert agent == "Tour", "nothing is asked of agents that are none"
        return self.copy

    def mint(self, agent: str, above: int) -> int:
        return (above // 65536 + 1) * 65536 + 1

    def hear(self, host: str, message: object) -> list[Effect]:
        return self.core.receive(host, message, self.now)  # type: ignore[arg-type]

    def pass_time(self, seconds: float) -> list[Effect]:
        """All that is done meanwhile, in time."""
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
        beats = [beat for _, beat in told(self.pass_time(0.6), Heartbeat)]
        self.hear("b", Ack(77, beats[-1].number, []))


def told(effects: Iterable[Effect], kind: type) -> list[tuple[str, object]]:
    """The messages of a kind, and to whom."""
    return [(e.host, e.message) for e in effects if isinstance(e, Tell) and isinstance(e.message, kind)]


def shadow(generation: int = 1, sequence: int = 3, interval: float = INTERVAL) -> Saved:
    return Saved(Place(generation, sequence, left=True), alive=False, interval=interval)


def alive(generation: int = 1, sequence: int = 3) -> Saved:
    return Saved(Place(generation, sequence, left=False), alive=True, interval=INTERVAL)


def proposed(effects: Iterable[Effect]) -> int:
    """The generation that is proposed; 0 if none is."""
    return max((m.generation for _, m in told(effects, Propose)), default=0)


def unknown() -> Sought:
    """The answer of who knows nothing."""
    return Sought("Tour", None)
