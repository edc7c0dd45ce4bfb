"""Portals with side effects: one resource with a portal for each kind of statement."""

from __future__ import annotations

import re

import pytest

from lfield.bytecode.program import Program
from lfield.bytecode.side_effects import effectful_methods
from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, Instruction, Parameter

ARM = DeviceManifest(
    "Arm",
    "test",
    (
        Instruction("angle", (), "real", "rad", effect="query"),
        Instruction("hold", (), "void", effect="idempotent"),
        Instruction("turn", (Parameter("angle", "real", "rad"),), "void", effect="actuate"),
    ),
)

CLASSES = """
class Point {
  public int x; public Point next;
  public Point(int x) { this.x = x; }
  public void move(int by) { x = x + by; }
  public void moveNext(int by) { next.move(by); }
  public void link(Point p) { next = p; }
  public void tidy() { try { x = x + 1; } finally { x = x - 1; } }
  public int far() { return x; }
}
resource Robot {
  Arm arm; int count; Point at; int[] log;
  init(string[] arg) { at = new Point(1); log = new int[4]; while (true) yield(); }
"""
QUERIES = """
  portal angle() emit real { return arm.angle(); }
  portal prints() { print("angle " + f2s(arm.angle())); write(count); sleep(0.1); }
  portal waits() { while (count < 3) yield(); }
  portal sum(int n) emit int { int s = 0; for (int i = 0; i < n; i = i + 1) { s = s + log[i]; } return s; }
  portal made() emit Point { Point p = new Point(count); p.x = 7; p.move(1); return p; }
  portal filled() emit real[] { real[] r = new real[2]; r[0] = arm.angle(); return r; }
  portal given(Point p, int[] a) emit int { p.x = 1; p.move(2); a[0] = 3; return p.x; }
  portal chosen(boolean b) emit Point { Point p = null; if (b) p = new Point(1); p.x = 2; return p; }
  portal callsHelper() emit int { return helper(3); }
  portal caught() emit int { try { return log[9]; } catch (IndexException e) { return random(3); } }
  portal tidied() emit int { try { return log[9]; } finally { print("tidied"); } }
  portal tidiedItself() { Point p = new Point(1); try { p.tidy(); } finally { p.x = 3; } }
  portal synchronized refused() { throw new DeviceException("no"); }
"""
ACTS = """
  portal turn() { arm.turn(1.0); }
  portal hold() { arm.hold(); }
  portal counts() emit int { count = count + 1; return count; }
  portal logs() { log[0] = 1; }
  portal logsAlias() { int[] l = log; l[1] = 2; }
  portal tidies() { try { print("tidies"); } finally { count = 0; } }
  portal moves() { at.move(1); }
  portal movesAlias(boolean b) { Point p = new Point(1); if (b) p = at; p.x = 2; }
  portal movesInside() { Point p = new Point(1); p.next = at; p.next.x = 3; }
  portal movesLinked() { Point p = new Point(1); p.link(at); p.moveNext(1); }
  portal keeps(Point p) { at = p; }
  portal links(Point p) { at.link(p); }
  portal linksThrough(Point p) { p.next.x = 4; }
  portal hidden(int n) { deep(n); }
  portal loops() { for (int i = 0; i < 2; i = i + 1) { if (i == 1) arm.turn(0.0); } }
  portal caughtActs() { try { print(log[9]); } catch (IndexException e) { count = 0; } }
  portal returned() { here().x = 5; }
  portal passed() { nudge(at); }
  portal thrown() { try { throw at; } catch (Point p) { p.x = 1; } }
  portal chained(int n) {
    Point a = null; Point b = null; Point c = null;
    for (int i = 0; i < n; i = i + 1) { if (a != null) a.x = 1; a = b; b = c; c = at; }
  }
"""
REST = """
  private int helper(int n) { if (n == 0) { return count; } return helper(n - 1) + at.far(); }
  private void deep(int n) { if (n > 0) deeper(n); }
  private void deeper(int n) { deep(n - 1); arm.turn(0.5); }
  private Point here() { return at; }
  private void nudge(Point p) { p.x = 6; }
}
coordinator Boss { init(string[] arg) { print(findRobot("robot").callsHelper()); } }
"""


@pytest.fixture(scope="module")
def program() -> Program:
    return compile_program(check_text(CLASSES + QUERIES + ACTS + REST, devices={"Arm": ARM}).or_raise())


def portals(text: str) -> list[str]:
    return re.findall(r"portal (?:synchronized )?(\w+)", text)


def test_a_portal_has_the_side_effects_of_the_methods_it_may_call(program: Program) -> None:
    found = effectful_methods(program)
    has_effects = {m.name: i in found for i, m in enumerate(program.core.methods) if m.kind == "portal"}
    assert has_effects == {**dict.fromkeys(portals(QUERIES), False), **dict.fromkeys(portals(ACTS), True)}


def test_a_portal_call_counts_as_a_side_effect(program: Program) -> None:
    """A coordinator that calls a portal may cause side effects in another agent."""
    init = next(i for i, m in enumerate(program.core.methods) if program.method_name(i) == "Boss.init")
    assert init in effectful_methods(program)


def test_the_methods_with_side_effects_are_computed_once(program: Program) -> None:
    assert effectful_methods(program) is effectful_methods(program)
