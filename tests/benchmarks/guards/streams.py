"""The processor time of hearing telemetry: four vehicles on one link, 200 messages a second each, by the
guard of a host and by pymavlink's own connection."""

from __future__ import annotations

import time
from pathlib import Path

from guards.copters import bindings, fake_copters
from guards.mavlink import RAW
from harness.checkout import Checkout, Mission
from harness.figure import Figure
from harness.number_text import PERCENT
from harness.paced import Round, read_round
from harness.processes import Processes
from harness.samples import Contender

SYSTEMS, RATE, SECONDS = (1, 2, 3, 4), 200, 3.0

_PROGRAM = """
resource Pilot {
    Mavlink fc;
    init(string[] arg) { write("ready\\n"); }
}
"""


def pymavlink(checkout: Checkout, processes: Processes) -> Contender:
    """mavlink_raw.py listens."""
    words = fake_copters(checkout, processes, SYSTEMS), str(RATE)

    def listen() -> Round:
        with Processes() as own:
            return read_round(checkout.run(own, RAW, "listen", *words, str(SECONDS), *map(str, SYSTEMS)))

    return listen


def guard(checkout: Checkout, processes: Processes) -> Contender:
    """The one guard of four agents."""
    port = fake_copters(checkout, processes, SYSTEMS)
    agents = [f"//Pilot:v{number}@here" for number in range(len(SYSTEMS))]
    mission = Mission(processes.folder(), _PROGRAM, agents, bindings([(port, system) for system in SYSTEMS]))
    (host,) = mission.up(checkout, processes)
    for _ in agents:
        host.line()
    (pid,) = map(int, Path(f"/proc/{host.pid}/task/{host.pid}/children").read_text(encoding="ascii").split())
    # The fake sends to everybody what one of them has asked for.
    read_round(checkout.run(processes, RAW, "listen", port, str(RATE), "0.1", *map(str, SYSTEMS)))

    def listen() -> Round:
        before, start = _processor(pid), time.perf_counter()
        time.sleep(SECONDS)
        return {"processor": [100 * (_processor(pid) - before) / (time.perf_counter() - start)]}

    return listen


def _processor(pid: int) -> float:
    """Seconds that it has used, by what clock_getcpuclockid(3) gives; /proc counts in steps of 10 ms."""
    return time.clock_gettime(~pid << 3 | 2)


FIGURE = Figure(
    "Hearing telemetry; ratio to pymavlink's mavutil",
    {"pymavlink": pymavlink, "a guard": guard},
    base=("pymavlink",),
    rounds=3,
    units={"processor": PERCENT},
    one_size="four vehicles, as many for each contender",
    targets={"a guard": "1.11x"},
    notes=(f"{len(SYSTEMS)} vehicles, {RATE} messages/s each, for {SECONDS:g} s",),
    between=("a guard",),
)
