"""A randomly changed program with `together`, `within`, `reserve`, `finally` is refused or harmless.

Programs that the verifier accepts run on a machine. After every round all memory blocks must be sound, and no
agent may have ended because of a bug in lfield.
"""

from __future__ import annotations

import contextlib
import random

import msgspec
import pytest

from lfield.bytecode.opcodes import BY_CODE, TABLE
from lfield.bytecode.program import Core, Handler, MethodRecord, Program, Quad, encode_quads
from lfield.bytecode.verifier import verify
from lfield.clock import ManualClock
from lfield.errors import ProgramFileError
from lfield.testing.golden import GoldenWorld, compile_text, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory.block_verifier import BlockVerifier

SOUND = compile_text(
    """
    resource Arm {
      int n = 0;
      init(string[] arg) { try { yield(); } finally { print("up"); } while (true) yield(); }
      portal lift(real height) emit real { sleep(1.0); return height; }
      portal name(string s) emit string { try { sleep(3.0); return s; } finally { n = n + 1; } }
      portal stop() { throw new DeviceException("stuck"); }
      portal report(DeviceException e) { print(e.others().length()); }
    }
    coordinator Boss {
      init(string[] arg) {
        Arm[] arms = findArm(); real got; int n = 3; string[] names = new string[3];
        try within (2.0) {
          together {
            got = arms[0].lift(1.0); arms[1].stop(); print(1);
            names[1] = arms[0].name("b"); inner(arms); names[2] = arms[1].name("a");
          }
        }
        catch (DeviceException e) { arms[0].report(e); }
        catch (TimeLimitException e) { print(e.others().length()); }
        try { n = n + 1; } catch (Exception e) { n = e.others().length(); } finally { n = n + 2; }
        print(inner(arms));
      }
      private int inner(Arm[] arms) {
        int[] other = new int[4];
        other[0] = 1; other[2] = 7; other[3] = -1;
        while (true) {
          reserve (arms) { reserve (arms[1]) { together { arms[1].lift(1.0); } } arms[0].lift(0.5); }
          together { arms[0].lift(2.0); arms[1].lift(3.0); if (arms.length() > 5) break; }
          within (1) { try { together { arms[0].lift(4.0); } } finally { print("in"); } }
          if (hops() == 0) return 3;
        }
        return 5;
      }
    }
    """
)
TEAM = [("Arm", "a1", ""), ("Arm", "a2", ""), ("Boss", "boss", "")]
NULL = -1 - SOUND.core.constants.index(None)
ROUNDS = 60


class ProgramMutator:
    """Random changes of a program in a few places. After most changes the types still fit."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.quads = list(SOUND.quads)
        self.methods = list(SOUND.core.methods)

    def core(self) -> Core:
        """The program, changed in up to three places."""
        for _ in range(self.rng.choice([1, 1, 2, 3])):
            self.rng.choice([self.operand, self.operand, self.operand, self.instruction, self.row])()
        return msgspec.structs.replace(SOUND.core, code=encode_quads(self.quads), methods=tuple(self.methods))

    def operand(self) -> None:
        """Replace an operand by another slot of the same type, null, or another jump target."""
        at = self.rng.randrange(len(self.quads))
        quad = list(self.quads[at])
        method = next(m for m in self.methods if m.entry <= at < m.end)
        operands = BY_CODE[quad[0]].operands
        positions = [i for i, operand in enumerate(operands) if operand.role in "DSVL"]
        if not positions:
            return
        position = self.rng.choice(positions)
        quad[1 + position] = self._other(method, operands[position].role, quad[1 + position])
        self.quads[at] = Quad(*quad)

    def _other(self, method: MethodRecord, role: str, number: int) -> int:
        if role == "L":
            return self.rng.randrange(method.entry, method.end)
        if not 0 <= number < len(method.slots):
            return number
        same = [slot for slot, kind in enumerate(method.slots) if kind == method.slots[number]]
        return self.rng.choice([*same, NULL])

    def instruction(self) -> None:
        """Replace an instruction by another opcode, or by another instruction of the program."""
        at, other = (self.rng.randrange(len(self.quads)) for _ in range(2))
        code = self.rng.choice(TABLE).code
        self.quads[at] = self.rng.choice([self.quads[at]._replace(op=code), self.quads[other]])

    def row(self) -> None:
        """Change or swap rows of a handler table."""
        index = self.rng.choice([i for i, m in enumerate(self.methods) if m.handlers])
        method = self.methods[index]
        rows = list(method.handlers)
        at, other = (self.rng.randrange(len(rows)) for _ in range(2))
        rows[at], rows[other] = rows[other], rows[at]
        field = self.rng.choice(["start", "end", "target", "slot", "kind"])
        number = self.rng.randint(method.entry, method.end)
        if field == "kind":
            rows[at] = Handler(rows[at].start, rows[at].end, 0, 0, rows[at].slot, self.rng.randrange(5))
        elif field == "slot":
            rows[at] = msgspec.structs.replace(rows[at], slot=self.rng.randrange(len(method.slots)))
        else:
            rows[at] = msgspec.structs.replace(rows[at], **{field: number})
        self.methods[index] = msgspec.structs.replace(method, handlers=tuple(rows))


def run(program: Program) -> None:
    """Run the program for some rounds. Check every memory block after each round."""
    world, clock = GoldenWorld(), ManualClock()
    team = team_for(program, TEAM)
    machine = world.machine = Machine(program, MachineTeam(team, 0, 1), world, clock, random.Random(1))
    block_verifier = BlockVerifier(program, machine.layouts, [member.type for member in team])
    for member in team:
        machine.start(member, AgentLimits(heap=1 << 16), generation=1)
    for _ in range(ROUNDS):
        pause = machine.run()
        for agent in machine.agents.values():
            if not agent.ended:
                block_verifier.check_heap(bytes(agent.block.image()), agent.block.limit + 256)
        if pause is None:
            break
        clock.advance(pause)
    assert not [agent.report for agent in world.endings if agent.report.startswith("bug in lfield")]


@pytest.mark.few(0)
@pytest.mark.parametrize("part", range(4))
def test_a_changed_program_is_refused_or_harmless(part: int) -> None:
    ran = 0
    for seed in range(100 * part, 100 * part + 100):
        program = Program(ProgramMutator(seed).core(), SOUND.debug, SOUND.digest)
        with contextlib.suppress(ProgramFileError):
            verify(program)
            ran += 1
            run(program)
    assert ran > 20
