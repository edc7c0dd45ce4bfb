"""The response time of `lfield lsp` to an edit in a program of 5,000 lines.

The program has 21 renamed copies of the ten kernels. Each sample is one edit and its answer, through the
pipes of the server process.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender
from lsp_session import LspSession

#: Copies of the kernels, and edits of each kind in a round.
COPIES, EDITS = 21, 20
NAME = "mission.L"


def program() -> str:
    """A program of 5,000 lines."""
    text = (Path(__file__).parents[1] / "machine" / "kernels.L").read_text(encoding="utf-8")
    units = re.findall(r"^(?:class|resource|coordinator) (\w+)", text, re.MULTILINE)
    names = re.compile(rf"\b(?:{'|'.join(units)})\b")
    return "\n".join(names.sub(rf"\g<0>{number}", text) for number in range(COPIES))


def server(checkout: Checkout, processes: Processes) -> Contender:
    """Start a server and open the program."""
    session, text = processes.keep(LspSession(processes.folder())), program()
    session.open(NAME, text)
    lines = text.split("\n")
    body = next(n for n, line in enumerate(lines) if "private int sort" in line and n > len(lines) // 2) + 1
    head = (
        next(n for n, line in enumerate(lines) if line.startswith("class Counter") and n > len(lines) // 2)
        + 1
    )
    session.await_diagnostics(NAME)

    def at(method: str, line: int, column: int) -> Callable[[], object]:
        return lambda: session.at(f"textDocument/{method}", NAME, line, column)

    def edited(line: int, text: str, answer: Callable[[], object]) -> tuple[list[float], float]:
        """Seconds of each edit with its answer, and the mean of the processor time."""
        samples, before = [], session.processor_time()
        for n in range(EDITS):
            start = time.perf_counter()
            session.change(NAME, line, 0, 0, f"{text}{n};")
            answer()
            samples.append(time.perf_counter() - start)
            session.change(NAME, line, 0, len(f"{text}{n};"), "")
            session.await_diagnostics(NAME)
        # Each edit is undone by a second one.
        return samples, (session.processor_time() - before) / (2 * EDITS)

    symbols = {"textDocument": session.document(NAME)}
    call = lines[body].index("numbers")
    kinds: dict[str, tuple[int, str, Callable[[], object]]] = {
        "findings": (body, "unknown = ", lambda: session.await_diagnostics(NAME)),
        "hover": (body, "int unused", at("hover", body + 1, call)),
        "completion": (body, "int unused", at("completion", body + 1, 8)),
        "definition": (body, "int unused", at("definition", body + 5, 12)),
        "outline": (body, "int unused", lambda: session.request("textDocument/documentSymbol", symbols)),
        "hover after a changed declaration": (head, "public int unused", at("hover", body + 1, call)),
    }

    def measured() -> dict[str, list[float]]:
        found: dict[str, list[float]] = {}
        for kind, edit in kinds.items():
            found[kind], used = edited(*edit)
            found[f"{kind}: processor time of an edit"] = [used]
        return found

    return measured


SERVER: Opener = server
FIGURE = Figure(
    "The language server: 5,000 lines, from an edit to the answer",
    {"lfield lsp": SERVER},
    rounds=5,
    one_size="a program of 5,000 lines, the size that must be answered within 100 ms",
    targets={"lfield lsp": "0.1 s"},
)
