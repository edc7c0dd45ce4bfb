"""The first second of a program: processor time of a whole process that runs a kernel and ends.

Each kernel takes CPython about a second. `lfield up` starts a host that loads the machine code of the
program before its agents start, and ends with the mission. With an empty cache it first compiles L text and
WebAssembly in child processes, whose time is included.
"""

from __future__ import annotations

import resource
from functools import partial
from pathlib import Path

from harness.checkout import Checkout, Mission
from harness.figure import Figure
from harness.paced import Round
from harness.processes import Child, ChildError, Processes
from harness.samples import Contender
from machine.first_second_kernels import KERNELS, SIZES

_HERE = Path(__file__).parent


def in_l(checkout: Checkout, processes: Processes, cached: bool) -> Contender:
    """Run each kernel as a mission of one host; with `cached` it has run before."""
    program = (_HERE / "first_second.L").read_text(encoding="utf-8")
    expected = {name: KERNELS[name](size) for name, size in SIZES.items()}

    missions = {
        name: Mission(processes.folder(), program, [f"//Kernel:k@here?{name}&{size}"])
        for name, size in SIZES.items()
    }
    shared = processes.folder()

    def seconds(own: Processes, name: str) -> float:
        arguments = *missions[name].arguments, *checkout.keeping_nothing, "--host", "here", "--until-done"
        cache = shared if cached else own.folder()
        environment = {**checkout.environment, "XDG_CACHE_HOME": str(cache)}
        command = checkout.python, "-m", "lfield", "up", *arguments
        child = own.start(*command, environment=environment, folder=checkout.root, merged=True)
        return _processor_seconds(child, f"{name} {expected[name]}")

    def took() -> Round:
        with Processes() as own:
            return {name: [seconds(own, name)] for name in SIZES}

    if cached:
        took()
    return took


def in_python(checkout: Checkout, processes: Processes) -> Contender:
    """Run each kernel as a Python program."""
    expected = {name: KERNELS[name](size) for name, size in SIZES.items()}

    def took() -> Round:
        found: Round = {}
        for name, size in SIZES.items():
            with Processes() as own:
                child = checkout.run(own, str(_HERE / "first_second_kernels.py"), name, str(size))
                found[name] = [_processor_seconds(child, f"{name} {expected[name]}")]
        return found

    return took


def _processor_seconds(child: Child, result: str) -> float:
    """Processor time of a process and its children. Raises ChildError for a wrong result."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    while not (line := child.line()).endswith(result):
        if "error" in line:
            raise ChildError(line)
    child.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


FIGURE = Figure(
    "The first second of a program, processor time of the whole process; ratio to CPython",
    {
        "lfield, has run before": partial(in_l, cached=True),
        "lfield, first run": partial(in_l, cached=False),
        "CPython": in_python,
    },
    base=("CPython",),
    rounds=7,
    one_size="four kernels, each a second in CPython",
    targets={f"lfield, has run before: {name}": "1.00x" for name in SIZES},
    between=("lfield, has run before", "lfield, first run"),
)
