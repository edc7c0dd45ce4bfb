from __future__ import annotations

import pytest
from debugger_recordings import EXAMPLES

from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.testing.recorded_run import record_mission


@pytest.fixture(scope="session")
def first_flight() -> TeamTimeline:
    """The recordings of the first example: two hosts, one coordinator, eleven hops."""
    recordings, mission = record_mission(EXAMPLES / "01-first-flight" / "mission.dL", 120.0)
    return TeamTimeline(recordings, mission)


@pytest.fixture
def debugger(first_flight: TeamTimeline) -> Debugger:
    """A debugger at the start of that recording."""
    return Debugger(first_flight)
