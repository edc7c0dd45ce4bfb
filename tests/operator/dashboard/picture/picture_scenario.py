"""A team's picture, made from events of its hosts."""

from __future__ import annotations

from dashboard_script import ScriptedHost, inventory

from lfield.driver.frame import Origin
from lfield.mission.bindings import Frames
from lfield.operator.team_model.team_view import TeamView
from lfield.wire.events import MigrationArrived, MigrationConfirmed, MigrationStarted


class Scenario:
    """A picture, and both hosts that send events to it, with monotonic clocks other than the test's."""

    def __init__(self, frames: Frames | None = None) -> None:
        self.picture = TeamView(inventory(frames))
        self.hosts = {"alpha": ScriptedHost(), "beta": ScriptedHost(8)}
        self.aside = {"alpha": -50.0, "beta": 4000.0}
        self.now = 100.0

    def tell(self, host: str, *whats: object, **more: object) -> None:
        batch = self.hosts[host].batch(self.now + self.aside[host], *whats, **more)  # type: ignore[arg-type]
        self.picture.feed(host, batch, self.now, 1.7e9)

    @property
    def seen(self):  # type: ignore[no-untyped-def]
        return self.picture.snapshot(self.now)


HOP = {
    "left": ("alpha", MigrationStarted("boss", 1, 4, "beta", "two", "lift", 900)),
    "came": ("beta", MigrationArrived("boss", 1, 4, "alpha", 900)),
    "hopped": ("alpha", MigrationConfirmed("boss", 1, 4, "beta", 0.02)),
}


ZURICH = Origin(47.3977, 8.5456, 488.0)
