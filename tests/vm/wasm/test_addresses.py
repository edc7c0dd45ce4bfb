"""Many agents with a limited address space (`ulimit -v`), and memory that is returned to the system."""

from __future__ import annotations

import subprocess
import sys

import pytest

from switching_engine import NEEDED

pytest.importorskip("wasmtime", reason=NEEDED)

from lfield.vm.wasm.arena import ADDRESS_SPACE, Arena

_MANY = """
import random, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]) << 20,) * 2)
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text
from lfield.vm.agent import TeamMember, MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.wasm.wasm_engine import WasmEngine
program = compile_text(
    "resource R { init(string[] arg) { for (int i = 0; i < 9; i = i + 1) sleep(1.0); print(arg[0]); } }"
)
desk, clock = GoldenWorld(), ManualClock()
team = [TeamMember(i, f"r{i}", "R", "resource", 0) for i in range(1000)]
machine = desk.machine = Machine(
    program, MachineTeam(team, 0, 1), desk, clock, random.Random(1), engines=WasmEngine
)
for member in team:
    machine.start(member, AgentLimits(), 1)
while (pause := machine.run()) is not None:
    clock.advance(pause)
outside = sum(machine.engine.space.base(agent.block.data) < 0 for agent in machine.agents.values())
print(len(desk.output), len(set(desk.output)), outside, machine.engine.space.reservation)
"""


@pytest.mark.few(1)
@pytest.mark.process
@pytest.mark.parametrize("most", [400, 1500])
def test_a_thousand_agents_need_few_addresses(most: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _MANY, str(most)], capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 0, done.stderr
    printed, different, outside, reservation = map(int, done.stdout.split())
    assert (printed, different, outside) == (1000, 1000, 0)
    assert reservation < ADDRESS_SPACE


def test_a_freed_large_region_uses_no_memory() -> None:
    arena = Arena()
    capacity = arena.allocate(32 << 20)
    capacity[:] = b"x" * len(capacity)
    base, full = arena.base(capacity), _resident()
    del capacity
    assert _resident() < full - (24 << 20)
    again = arena.allocate(32 << 20)
    assert arena.base(again) == base
    assert not any(again[:: 1 << 12])


def _resident() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096
