"""Runs the mission of a deployment in virtual time; prints its seconds, processor seconds, and hops."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from lfield.testing.mission.mission_team import MissionTeam


def main() -> None:
    """Load the mission before the measurement: loading is mostly compilation."""
    team = MissionTeam(Path(sys.argv[1]).resolve())
    started, clock = team.now, time.process_time()
    team.run(until_done=True)
    elapsed = time.process_time() - clock
    print(team.now - started, elapsed, len(team.hops), flush=True)


if __name__ == "__main__":
    main()
