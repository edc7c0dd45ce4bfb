"""The end of a mission in which a coordinator has started another one, from events."""

from __future__ import annotations

from lfield.clock import ManualClock
from lfield.operator.team_model.mission_end import MissionEnd
from lfield.wire import events
from lfield.wire.events import Event
from lfield.wire.subscription_messages import EventBatch


class Ends:
    """The ends of a mission of one host, from its events."""

    def __init__(self) -> None:
        self.end = MissionEnd(["alpha"], {"boss": "alpha"}, 5.0, ManualClock())
        self._number = 0

    def on(self, *happened: events.StateEvent) -> list[tuple[str, str]] | None:
        first = self._number
        found = []
        for what in happened:
            self._number += 1
            found.append(Event(self._number, 0.0, 0.0, 0, what))
        self.end.on_batch("alpha", EventBatch(1, 1, 0.0, 0.0, first, self._number, found), None)
        self.end.check()
        return None if self.end.outcomes is None else [(one.agent, one.outcome) for one in self.end.outcomes]


def test_a_mission_lasts_until_the_started_coordinator_has_ended() -> None:
    ends = Ends()
    assert ends.on(events.AgentStarted("post", 0), events.AgentStarted("boss", 1)) is None
    assert ends.on(events.AgentStarted("patrol", 1), events.AgentFinished("boss", 1, "done")) is None
    assert (
        ends.on(events.AgentFinished("patrol", 1, "done", "stopped"), events.AgentStarted("patrol", 2))
        is None
    )
    assert ends.on(events.AgentFinished("patrol", 2, "died", "it failed")) == [("boss", "done")]


def test_a_resource_is_not_waited_for() -> None:
    ends = Ends()
    assert ends.on(events.AgentStarted("post", 0), events.AgentStarted("boss", 1)) is None
    assert ends.on(events.AgentFinished("boss", 1, "done")) == [("boss", "done")]
