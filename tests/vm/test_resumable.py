"""The output of a program does not depend on the interruption of its threads and the collection of its
heap."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, team_for
from lfield.vm import machine as machine_module
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory.collector import collect

EXAMPLES = Path(__file__).parents[2] / "examples"

BUSY = """
class Tree { public int key; public Tree left; public Tree right;
  public Tree(int k) { key = k; }
  public void insert(int k) {
    if (k < key) { if (left == null) left = new Tree(k); else left.insert(k); }
    else if (right == null) right = new Tree(k); else right.insert(k);
  }
  public int sum() {
    int s = key;
    if (left != null) s = s + left.sum();
    if (right != null) s = s + right.sum();
    return s;
  }
}
resource Store {
  Tree root; string text;
  init(string[] arg) { root = new Tree(50); text = ""; }
  portal synchronized put(int k, string who) { root.insert(k); text = text + who; }
  portal total() emit int { return root.sum(); }
  portal fail(int k) emit int { int[] a = new int[k]; return a[k]; }
}
coordinator Filler {
  init(string[] arg) {
    Store s = findStore("store");
    for (int i = 0; i < 10; i = i + 1) { s.put(i * 7 % 100, "x"); yield(); }
    try { s.fail(3); } catch (IndexException e) { print(e.message()); }
    print(s.total());
  }
}
"""


def run(slice_length: int, monkeypatch: pytest.MonkeyPatch, collecting: bool) -> list[str]:
    monkeypatch.setattr(machine_module, "SLICE", slice_length)
    program = compile_text(BUSY)
    desk, clock = GoldenWorld(), ManualClock()
    team = team_for(program, [("Store", "store", ""), ("Filler", "a", "")])
    machine = Machine(program, MachineTeam(team, 0, 1), desk, clock, random.Random(1))
    for member in team:
        machine.start(member, AgentLimits(), 1)
    while (pause := machine.run()) is not None:
        clock.advance(pause)
        if collecting:
            for agent in machine.agents.values():
                collect(agent.block, machine.layouts)
    return desk.output


@pytest.mark.parametrize("collecting", [False, True])
@pytest.mark.parametrize("slice_length", [1, 2, 3, 17, 100_000])
def test_the_output_is_the_same_for_all_slices_and_collections(
    slice_length: int, collecting: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("SLICES_PER_RUN", "TURNS_PER_RUN"):
        monkeypatch.setattr(machine_module, name, 1 if collecting else 200)
    assert run(slice_length, monkeypatch, collecting) == ["index 3 of an array of length 3", "365"]
