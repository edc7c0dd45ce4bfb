"""A query of telemetry in L, beside reading a variable: the host's last snapshot is at hand."""

from __future__ import annotations

from pathlib import Path

from guards.copters import bindings, fake_copters
from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender

BATCHES, READS = 20, 1000


def asking(commands: int, batches: int) -> Opener:
    """The pilot of device.L, with a fake copter behind its guard."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        devices = bindings([(fake_copters(checkout, processes), 1)])
        agents = [f"//Pilot:v0@here?{commands}&{batches}&{READS}"]
        return paced_mission(checkout, processes, Path(__file__).with_name("device.L"), agents, devices)

    return opener


FIGURE = Figure(
    "A query of telemetry",
    {"lfield": asking(0, BATCHES)},
    one_size="a query is of one value",
    targets={"a query of telemetry": "5 µs more"},
    notes=(f"a sample is the mean of {READS} reads; the target is against a variable",),
    between=("lfield",),
)
