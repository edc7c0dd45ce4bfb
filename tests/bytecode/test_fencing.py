"""A coordinator is fenced if it may set a heartbeat interval; the program alone decides this."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.side_effects import fenced_classes
from lfield.mission.loader import load_program
from lfield.testing.golden import compile_text

PROGRAM = """
resource Post { init(string[] arg) { } portal say() { } }
class Plain { public int n; public void add() { n = n + 1; } }
class Keeper coordinator specific {
  public Keeper() { }
  public Keeper(real s) { keep(s); }
  private void keep(real s) { heartbeatInterval(s); }
  public void rest() { if (hops() > 3) { again(5); } }
  private void again(int n) { if (n > 0) { again(n - 1); } else { other(); } }
  private void other() { keep(-1.0); rest(); }
  public void harmless() { }
}
coordinator None { init(string[] arg) { Plain p = new Plain(); p.add(); findPost("p").say(); } }
coordinator Holder { Keeper kept; init(string[] arg) { kept = new Keeper(); kept.harmless(); } }
coordinator Own { init(string[] arg) { heartbeatInterval(2); } }
coordinator Off { init(string[] arg) { heartbeatInterval(-1); } }
coordinator Never { init(string[] arg) { if (false) { heartbeatInterval(2); } } }
coordinator Late { init(string[] arg) { return; heartbeatInterval(2); } }
coordinator Uncalled { init(string[] arg) { } private void spare() { heartbeatInterval(2); } }
coordinator Caught { init(string[] arg) { try { print(1); } catch (Exception e) { heartbeatInterval(2); } } }
coordinator Made { init(string[] arg) { Keeper k = new Keeper(2.0); } }
coordinator Field { Keeper kept = new Keeper(2.0); init(string[] arg) { } }
coordinator Deep { init(string[] arg) { new Keeper().rest(); } }
"""
#: The compiler leaves out code that is never reached.
FENCED = {"Own", "Off", "Uncalled", "Caught", "Made", "Field", "Deep"}


def test_a_coordinator_that_may_set_an_interval_is_fenced() -> None:
    program = compile_text(PROGRAM)
    assert fenced_classes(program) == FENCED
    # A robot that reads the encoded program gets the same result.
    assert fenced_classes(decode(encode(program))) == FENCED


#: Without the examples that contain a driver, because the driver may not be installed.
EXAMPLES = [
    path
    for path in sorted(Path(__file__).parents[2].glob("examples/*/*.L"))
    if "<arena/" not in "".join(other.read_text() for other in path.parent.glob("*.L"))
    and not list(path.parent.rglob("pyproject.toml"))
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_an_example_without_heartbeat_interval_is_not_fenced(example: Path) -> None:
    if "heartbeatInterval" not in example.read_text():
        assert not fenced_classes(load_program(example))
