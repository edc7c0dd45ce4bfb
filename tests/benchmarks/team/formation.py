"""Three legs of two copters, flown one after another and together: fake ArduCopters, real hosts on loopback.

Each flies its three legs at its own speed, so together takes as long as the slower one of each leg.
"""

from __future__ import annotations

import re
from pathlib import Path

from guards.copters import bindings, fake_copters
from harness.checkout import Checkout, Mission
from harness.figure import Figure, Opener
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

AGENTS = ("//Copter:v0@a", "//Copter:v1@b", "//Formation:formation@a")
WAYS = {"one after another": ("", ""), "together": ("together {", "}")}
CASE = "three legs of two copters"

#: Seconds that a flight may take.
PATIENCE = 120.0

_PROGRAM = Path(__file__).with_name("formation.L")
_FLOWN = re.compile(r"flown in ([\d.]+) s")


def flown(way: str) -> Opener:
    """How long it takes in one way."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        return lambda: _round(checkout, *WAYS[way])

    return opener


def _round(checkout: Checkout, begin: str, end: str) -> Round:
    """One flight on fresh fakes."""
    program = _PROGRAM.read_text(encoding="utf-8").replace("BEGIN", begin).replace("END", end)
    with Processes() as processes:
        ports = [fake_copters(checkout, processes, (system,)) for system in (1, 2)]
        copters = list(zip(ports, (1, 2), strict=True))
        mission = Mission(processes.folder(), program, AGENTS, bindings(copters))
        hosts = [mission.host(checkout, processes, host, merged=True) for host in mission.addresses]
        while not (told := _FLOWN.search(hosts[0].line(PATIENCE))):
            pass
        return {CASE: [float(told[1])]}


FIGURE = Figure(
    "A three-leg flight of two copters, one after another and together",
    {way: flown(way) for way in WAYS},
    base=("one after another",),
    rounds=2,
    one_size="two copters",
)
