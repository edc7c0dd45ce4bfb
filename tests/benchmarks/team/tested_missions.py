"""How fast the tests of missions are: the seconds of an example's mission against those of the processor.

Real hosts, guards, drivers and fakes run in one process on virtual time; a ratio of 0.03 is 33 seconds of the
mission in one of a processor. What else the computer does counts for nothing.
"""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

#: By what flies or moves in each.
CASES = {
    "two copters": "01-first-flight",
    "a crane, a copter, an arm, a hand": "02-equivalent-lift",
    "a copter, a winch, a hand": "03-mixed-team",
    "a copter, a rover with a winch, an arm": "04-the-mission-survives",
    "no devices": "11-multiple-tiers",
}
#: Seconds that the slowest may take on a slow computer.
PATIENCE = 300.0
MISSION, TEST = "the mission", "its test"

_TESTED = str(Path(__file__).with_name("tested_mission.py"))


def seconds(number: int) -> Opener:
    """Of the mission itself (0), or of its test (1)."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            rounds = {}
            for case, example in CASES.items():
                with Processes() as processes:
                    mission = checkout.root / "examples" / example / "mission.dL"
                    said = checkout.run(processes, _TESTED, str(mission)).line(PATIENCE)
                    rounds[case] = [float(said.split()[number])]
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
