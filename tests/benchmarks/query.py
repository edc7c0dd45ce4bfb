"""A query of telemetry in L, compared with reading a variable: the host's last snapshot is at hand."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from harness import Figure, Row, in_turns, median, microseconds, percentile, times

from lfield.bytecode.program import DeviceCall, Program
from lfield.clock import SystemClock
from lfield.compiler.build import compile_program
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, DeviceValue, Instruction
from lfield.testing.golden import Desk, team_for
from lfield.vm.agent import Agent
from lfield.vm.contract import Limits, Reading
from lfield.vm.machine import Machine
from lfield.vm.memory.values import word_of

BATCHES, READS, ROUNDS = 10, 2000, 10
#: What a query may cost more than a variable, in seconds.
TARGET = 5e-6

_GAUGE = DeviceManifest("Gauge", "test", (Instruction("level", (), "real", "m", effect="query"),))
_PROGRAM = """
resource R {
    Gauge g;
    init(string[] arg) {
        real level = 1.5;
        real seen = 0.0;
        for (int batch = 0; batch < %d; batch = batch + 1) {
            real start = now();
            for (int i = 0; i < %d; i = i + 1) seen = %s;
            print((now() - start) / %d);
        }
    }
}
"""


class _World(Desk):
    """One gauge whose reading is always fresh."""

    def __init__(self) -> None:
        super().__init__()
        self._reading = Reading()
        self._reading.word, self._reading.until = word_of(1.5), math.inf

    def device(self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]) -> DeviceValue:
        return 1.5

    def reading(self, agent: Agent, call: DeviceCall) -> Reading:
        return self._reading


def figure() -> Figure:
    """The two in turns, and their difference against the target."""
    samples = in_turns({"query": _reads("g.level()"), "variable": _reads("level")}, ROUNDS)
    variable, query = median(samples["variable"]), median(samples["query"])
    more = query - variable
    rows = (
        _row(samples, "variable", variable),
        _row(samples, "query", variable),
        Row("", "the difference", microseconds(more), "", times(more / TARGET), "1.00x"),
    )
    note = f"{ROUNDS} rounds of {BATCHES} batches of {READS}; the target is {TARGET * 1e6:g} us more"
    return Figure("A query of telemetry; ratio to reading a variable", rows, (note,))


def _row(samples: dict[str, list[float]], name: str, against: float) -> Row:
    own = samples[name]
    return Row(
        "L",
        f"lfield: {name}",
        microseconds(median(own)),
        microseconds(percentile(own, 99)),
        times(median(own) / against),
    )


def _reads(expression: str) -> Callable[[], list[float]]:
    text = _PROGRAM % (BATCHES, READS, expression, READS)
    program: Program = compile_program(check_text(text, devices={"Gauge": _GAUGE}).or_raise())

    def batches() -> list[float]:
        world = _World()
        machine = Machine(program, team_for(program, []), 0, world, SystemClock(), random.Random(1))
        machine.start(machine.team[0], Limits(heap=1 << 20), 1)
        while machine.run() is not None:
            pass
        return [float(line) for line in world.output]

    return batches
