"""Growing arrays and maps: run time of the same ten programs in L and in CPython with lists and dicts.

Every engine of the host is measured; each compares its results with those of CPython.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender, timed
from machine.collection_kernels import KERNELS
from machine.engine import LONG, MEAN, with_mean

_PROGRAM = Path(__file__).with_name("collections.L")


def in_l(checkout: Checkout, processes: Processes, engine: str) -> Contender:
    """Run collections.L on a host with this engine."""
    agents = [f"//Bench:bench@here?{'&'.join(str(run()) for run in KERNELS.values())}"]
    return with_mean(paced_mission(checkout, processes, _PROGRAM, agents, options=checkout.engines[engine]))


def in_python(checkout: Checkout, processes: Processes) -> Contender:
    """Run collection_kernels.py in this process."""
    return with_mean(lambda: {name: [timed(run, LONG)] for name, run in KERNELS.items()})


def _engines() -> dict[str, Opener]:
    return {f"lfield, {name}": partial(in_l, engine=name) for name in sorted(Checkout.own().engines)}


FIGURE = Figure(
    "Arrays and maps in L, lists and dicts in CPython: seconds of one run; ratio to CPython",
    {**_engines(), "CPython": in_python},
    base=("CPython",),
    rounds=9,
    one_size="ten programs, each with its own work",
    targets={f"lfield, wasm: {MEAN}": "1x"},
    notes=(f"a sample is the mean over {LONG * 1e3:g} ms",),
    between=tuple(_engines()),
)
