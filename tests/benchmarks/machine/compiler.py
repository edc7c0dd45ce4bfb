"""The time from an L text to its program, and its growth with the length of the text; in one process.

The figure `compile` has the additional cost of a command. The remaining syntax trees have reference cycles:
Python's garbage collector frees them later, which is counted separately.
"""

from __future__ import annotations

import gc
import re
import time
from collections.abc import Callable
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

from lfield.driver.plugins import discover
from lfield.mission.loader import compile_file

LINES = (500, 1_500, 5_000)
_PIECE = Path(__file__).with_suffix(".L").read_text(encoding="utf-8")


def compiled(checkout: Checkout, processes: Processes) -> Contender:
    """Compile programs of all lengths, each in one file."""
    folder, plugins = processes.folder(), discover()
    paths = {lines: folder / f"program{lines}.L" for lines in LINES}
    for lines, path in paths.items():
        path.write_text(_program(lines), encoding="utf-8")

    def measured() -> Round:
        found: Round = {}
        for lines, path in paths.items():
            gc.collect()
            gc.disable()
            found[_case(lines)] = [_seconds(lambda p=path: compile_file(p, plugins))]
            found[f"{_case(lines)}: what is left over"] = [_seconds(gc.collect)]
            gc.enable()
        return found

    measured()
    return measured


def _seconds(work: Callable[[], object]) -> float:
    """Processor time, without that of other processes."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _program(lines: int) -> str:
    pieces = -(-lines // _PIECE.count("\n"))
    return "".join(re.sub(r"(?<=[a-z])N\b", str(piece), _PIECE) for piece in range(pieces))


def _case(lines: int) -> str:
    return f"{lines:,} lines"


FIGURE = Figure(
    "From L text to a program, seconds of a processor",
    {"the compiler": compiled},
    rounds=9,
    sizes={_case(lines): lines for lines in LINES},
    targets={f"the compiler: {_case(500)}": "50.0 ms", "the compiler: ten times the size": "11x"},
    notes=("files are read, programs are verified; nothing is written",),
)
