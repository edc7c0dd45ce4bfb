"""The speed of mission tests: the seconds of an example's mission compared with processor seconds.

Real hosts, guards, drivers and fakes run in one process in virtual time; a ratio of 0.03 is 33 mission
seconds in one processor second. Other load of the computer has no effect.
"""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

#: Examples by their robots.
CASES = {
    "two copters": "01-first-flight",
    "a crane, a copter, an arm, a hand": "02-equivalent-lift",
    "a copter, a winch, a hand": "03-mixed-team",
    "a copter, a rover with a winch, an arm": "04-the-mission-survives",
    "no devices": "11-multiple-tiers",
}
#: Seconds for the slowest mission on a slow computer.
TIMEOUT = 300.0
MISSION, TEST = "the mission", "its test"

_TESTED = str(Path(__file__).with_name("tested_mission.py"))


def seconds(number: int) -> Opener:
    """Seconds of the mission (0), or of its test (1)."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            rounds = {}
            for case, example in CASES.items():
                with Processes() as processes:
                    mission = checkout.root / "examples" / example / "mission.dL"
                    output = checkout.run(processes, _TESTED, str(mission)).line(TIMEOUT)
                    rounds[case] = [float(output.split()[number])]
            return rounds

        return measure

    return opener


FIGURE = Figure(
    "A mission's seconds, and the processor's of its test on virtual time",
    {MISSION: seconds(0), TEST: seconds(1)},
    base=(MISSION,),
    rounds=3,
    one_size="one mission",
)
