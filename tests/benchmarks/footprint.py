"""What a host without drivers costs: memory, processor time while its agents idle, and time to start.

Real `lfield up --host` processes, with their defaults. Processor time is what the scheduler charged to the
process (/proc/PID/task/*/schedstat) over some idle seconds; the parked and the polling host idle at the
same time. Start-up is from just before the process is created to the line that the portal writes; the
start of a bare Python, which is part of it, is measured in turns with it. Python keeps compiled modules on
disk, as it does after the first start of an installed program, whatever this environment says.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from harness import Child, Children, Figure, Row, free_port, in_turns, median, percentile, times

IDLE_SECONDS, STARTS = 5.0, 9
#: What the host must keep to: megabytes, percent of a processor, seconds.
TARGET_MEMORY, TARGET_IDLE, TARGET_START = 45.0, 1.0, 0.7

_BARE = "bare Python that prints"

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


def figure() -> Figure:
    """Memory, idle processor time, start-up."""
    with tempfile.TemporaryDirectory() as name:
        folder, environment = Path(name), _compiled_modules_in(Path(name) / "modules")
        for loop, statement in _LOOPS.items():
            _write_mission(folder / loop, statement, environment)
        idle = _idle_rows(folder, environment)
        starts = _start_rows(folder, environment)
    note = f"idle for {IDLE_SECONDS:g} s; {STARTS} rounds of starts"
    return Figure("A host with no drivers; ratio to its target", [*idle, *starts], (note,))


def _compiled_modules_in(folder: Path) -> dict[str, str]:
    """An environment in which Python keeps compiled modules there."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPYCACHEPREFIX": str(folder)}


def _write_mission(stem: Path, loop: str, environment: dict[str, str]) -> None:
    """A mission of one host and one resource that idles in its own way, as text and as a program file."""
    stem.with_suffix(".L").write_text(_PROGRAM % loop, encoding="utf-8")
    stem.with_suffix(".dL").write_text("//Part:part@here\n//First:first@here\n", encoding="utf-8")
    with Children() as children:
        source, output = str(stem.with_suffix(".L")), str(stem.with_suffix(".lb"))
        built = children.start(*_lfield("build"), source, "-o", output, environment=environment)
        built.wait()


def _lfield(command: str) -> tuple[str, ...]:
    return sys.executable, "-m", "lfield", command


def _up(stem: Path, suffix: str) -> tuple[str, ...]:
    """The command that runs a mission's host from L text or a program file."""
    return (
        *(*_lfield("up"), "--deploy", str(stem.with_suffix(".dL")), "--host", "here"),
        *("--program", str(stem.with_suffix(suffix)), "--map", f"here=127.0.0.1:{free_port()}"),
    )


# --- memory and idling --------------------------------------------------------------------------------


def _idle_rows(folder: Path, environment: dict[str, str]) -> list[Row]:
    with Children() as children:
        commands = {
            "L text, parked": _up(folder / "parked", ".L"),
            "program file, parked": _up(folder / "parked", ".lb"),
            "program file, polling": _up(folder / "polling", ".lb"),
        }
        hosts = {name: children.start(*words, environment=environment) for name, words in commands.items()}
        for host in hosts.values():
            host.line()
        # What is left of starting up must not count as idling.
        time.sleep(1.0)
        before = {name: _processor_seconds(host) for name, host in hosts.items()}
        start = time.perf_counter()
        time.sleep(IDLE_SECONDS)
        spent = time.perf_counter() - start
        idle = {n: 100 * (_processor_seconds(host) - before[n]) / spent for n, host in hosts.items()}
        memory = {name: _resident_megabytes(host) for name, host in hosts.items()}
    rows: list[Row] = []
    for name, own in memory.items():
        case = "" if rows else "resident memory"
        ratio, target = times(own / TARGET_MEMORY), f"{TARGET_MEMORY:g} MB"
        rows.append(Row(case, name, f"{own:.1f} MB", "", ratio, target))
    for name, own in idle.items():
        case = "processor, idle" if len(rows) == len(memory) else ""
        rows.append(Row(case, name, f"{own:.2f} %", "", times(own / TARGET_IDLE), f"{TARGET_IDLE:g} %"))
    return rows


def _resident_megabytes(host: Child) -> float:
    lines = Path(f"/proc/{host.pid}/status").read_text(encoding="ascii").splitlines()
    (line,) = [line for line in lines if line.startswith("VmRSS:")]
    return int(line.split()[1]) * 1024 / 1e6


def _processor_seconds(host: Child) -> float:
    """What all its threads have run."""
    tasks = Path(f"/proc/{host.pid}/task").glob("*/schedstat")
    return sum(int(task.read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9


# --- start-up -----------------------------------------------------------------------------------------


def _start_rows(folder: Path, environment: dict[str, str]) -> list[Row]:
    commands: dict[str, Callable[[], tuple[str, ...]]] = {
        "L text": partial(_up, folder / "parked", ".L"),
        "program file": partial(_up, folder / "parked", ".lb"),
        _BARE: lambda: (sys.executable, "-c", "print('called')"),
    }
    starts = {name: partial(_first_line, command, environment) for name, command in commands.items()}
    samples = in_turns(starts, STARTS)
    rows: list[Row] = []
    for name, own in samples.items():
        case = "" if rows else "start to first portal call"
        judged = () if name == _BARE else (times(median(own) / TARGET_START), f"{TARGET_START:g} s")
        rows.append(Row(case, name, f"{median(own):.3f} s", f"{percentile(own, 99):.3f} s", *judged))
    return rows


def _first_line(command: Callable[[], tuple[str, ...]], environment: dict[str, str]) -> list[float]:
    """Seconds from the start of a command to its first line."""
    with Children() as children:
        child = children.start(*command(), environment=environment)
        child.line()
        return [time.perf_counter() - child.started]
