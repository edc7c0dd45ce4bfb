"""The engine's speed: run time of the same ten programs in L and in CPython."""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure
from harness.processes import Processes
from harness.samples import Contender, timed
from machine.kernels import KERNELS

#: Seconds that a sample of CPython takes at least: one run would be over before it can be trusted.
LONG = 20e-3


def in_l(checkout: Checkout, processes: Processes) -> Contender:
    """kernels.L on a host; it compares what each gives with what CPython gives."""
    expected = "&".join(str(run()) for run in KERNELS.values())
    program = Path(__file__).with_name("kernels.L")
    return paced_mission(checkout, processes, program, [f"//Bench:bench@here?{expected}"])


def in_python(checkout: Checkout, processes: Processes) -> Contender:
    """kernels.py in this process."""
    return lambda: {name: [timed(run, LONG)] for name, run in KERNELS.items()}


FIGURE = Figure(
    "The same program in L and in CPython: seconds of one run; ratio to CPython",
    {"lfield": in_l, "CPython": in_python},
    base=("CPython",),
    rounds=9,
    notes=(f"a sample of CPython is the mean of {LONG * 1e3:g} ms of runs",),
    between=("lfield",),
)
