"""A mission of one host with an idle resource and no devices: the basic cost of a host."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from harness.checkout import Checkout, Mission
from harness.figure import Opener
from harness.paced import Round
from harness.processes import Child, Processes
from harness.samples import Contender

#: Measures one start of a host with these options.
Measure = Callable[[Checkout, Sequence[str]], Round]

_LOOPS = {"parked": "while (true) yield();", "polling": "while (!done) yield();"}
_PROGRAM = """
resource Part {
    boolean done;

    init(string[] arg) {
        done = false;
        %s
    }

    portal hello() { write("called\\n"); }
}

coordinator First {
    init(string[] arg) {
        Part part = findPart("part");
        part.hello();
    }
}
"""


def small_host(measure: Measure, loop: str = "parked", compiled: bool = False, engine: str = "") -> Opener:
    """Each round starts a new host, which compiles L text at its start or runs a program file.

    Without `engine` the host selects its engine.
    """

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        agents = "//Part:part@here", "//First:first@here"
        mission = Mission(processes.folder(), _PROGRAM % _LOOPS[loop], agents)
        arguments = [*mission.arguments, *checkout.keeping_nothing, "--host", "here"]
        if compiled:
            built = mission.folder / "mission.lb"
            checkout.lfield(processes, "build", str(mission.source), "-o", str(built)).wait()
            arguments += ["--program", str(built)]
        arguments += checkout.engines[engine] if engine else ()
        return lambda: measure(checkout, arguments)

    return opener


def started(checkout: Checkout, processes: Processes, words: Sequence[str]) -> tuple[Child, Round]:
    """Start a host and wait for its first portal call; returns the host and the seconds."""
    host, took = checkout.lfield(processes, "up", *words, merged=True), {}
    while (line := host.line()) != "called":
        if " listening " in line:
            took["until it is up"] = [time.perf_counter() - host.started]
    took["to the first portal call"] = [time.perf_counter() - host.started]
    return host, took | {"the same, processor": [processor_seconds(Path(f"/proc/{host.pid}"))]}


def processor_seconds(folder: Path) -> float:
    """Processor time of all threads of a process; `folder` is its folder in /proc."""
    tasks = (folder / "task").glob("*/schedstat")
    return sum(int(task.read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9


def settled(checkout: Checkout, processes: Processes, words: Sequence[str]) -> Path:
    """Start a host and wait until its start is complete; returns its /proc folder."""
    host, _ = started(checkout, processes, words)
    time.sleep(0.5)
    return Path(f"/proc/{host.pid}")
