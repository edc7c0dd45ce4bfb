"""What the commands that compile take, from start to end: a program of its own, and one with stock resources."""

from __future__ import annotations

import shutil
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Contender, Figure, Opener
from harness.paced import Round
from harness.processes import Processes

_KERNELS = Path(__file__).with_name("kernels.L")
_EXAMPLE = Checkout.own().root / "examples/03-mixed-team/mission.L"
PROGRAMS = {"the ten kernels": _KERNELS, "03-mixed-team": _EXAMPLE}


def command(*words: str) -> Opener:
    """A subcommand, on a copy of each program."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        folder = processes.folder()
        for name, path in PROGRAMS.items():
            shutil.copy(path, folder / f"{name}.L")

        def took() -> Round:
            with Processes() as own:
                return {n: [checkout.lfield(own, *words, str(folder / f"{n}.L")).wait()] for n in PROGRAMS}

        return took

    return opener


FIGURE = Figure(
    "Compiling: a command from its start to its end",
    {"lfield check": command("check"), "lfield build": command("build")},
    rounds=9,
    between=("lfield check", "lfield build"),
)
