"""The engines' speed: run time of the same ten programs in L, in CPython and in other installed languages.

The programs are like those of chapter III. Every engine of the host is measured, and C and JavaScript where
they are installed; each compares its results with those of CPython.
"""

from __future__ import annotations

import math
import shutil
import subprocess
from functools import partial
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.paced import Paced, Round
from harness.processes import Processes
from harness.samples import Contender, median, timed
from machine.kernels import KERNELS

#: The least seconds of a sample: one run is too short for a reliable measurement.
LONG = 20e-3
MEAN = "geometric mean"
_HERE = Path(__file__).parent


def in_l(checkout: Checkout, processes: Processes, engine: str) -> Contender:
    """Run kernels.L on a host with this engine."""
    agents = [f"//Bench:bench@here?{'&'.join(_expected())}"]
    options = checkout.engines[engine]
    return with_mean(paced_mission(checkout, processes, _HERE / "kernels.L", agents, options=options))


def in_python(checkout: Checkout, processes: Processes) -> Contender:
    """Run kernels.py in this process."""
    return with_mean(lambda: {name: [timed(run, LONG)] for name, run in KERNELS.items()})


def in_c(checkout: Checkout, processes: Processes) -> Contender:
    """Compile and run kernels.c."""
    program = processes.folder() / "kernels"
    subprocess.run(["cc", "-O1", str(_HERE / "kernels.c"), "-o", str(program)], check=True)
    return with_mean(Paced([processes.start(str(program), *_expected())]))


def in_javascript(checkout: Checkout, processes: Processes) -> Contender:
    """Run kernels.js."""
    return with_mean(Paced([processes.start("node", str(_HERE / "kernels.js"), *_expected())]))


def _expected() -> list[str]:
    return [str(run()) for run in KERNELS.values()]


def with_mean(contender: Contender) -> Contender:
    """Add the geometric mean of the programs to each round."""

    def measured() -> Round:
        found = {case: list(samples) for case, samples in contender().items()}
        logarithms = [math.log(median(samples)) for samples in found.values()]
        return found | {MEAN: [math.exp(sum(logarithms) / len(logarithms))]}

    return measured


def _engines() -> dict[str, Opener]:
    return {f"lfield, {name}": partial(in_l, engine=name) for name in sorted(Checkout.own().engines)}


_OTHERS: dict[str, tuple[str, Opener]] = {"C, -O1": ("cc", in_c), "node": ("node", in_javascript)}

FIGURE = Figure(
    "The same program in L and in CPython: seconds of one run; ratio to CPython",
    {
        **_engines(),
        "CPython": in_python,
        **{name: opener for name, (command, opener) in _OTHERS.items() if shutil.which(command)},
    },
    base=("CPython",),
    rounds=9,
    one_size="ten programs, each with its own work",
    targets={
        "lfield, wasm: loop": "0.12x",
        "lfield, wasm: fib": "0.25x",
        f"lfield, wasm: {MEAN}": "0.20x",
    },
    notes=(f"a sample is the mean over {LONG * 1e3:g} ms; in C exceptions are statuses and memory is freed",),
    between=tuple(_engines()),
)
