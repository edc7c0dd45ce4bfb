"""`lfield inspect` prints the time without a heartbeat after which a coordinator is recovered."""

from __future__ import annotations

import pytest

from lfield.testing.golden import run_text
from lfield.vm.inspection import dump_file


@pytest.mark.parametrize(
    ("calls", "message"),
    [
        ("heartbeatInterval(2.5);", ["heartbeat failover 2.5 s after its last heartbeat"]),
        ("heartbeatInterval(0.0001);", ["heartbeat failover 0.001 s after its last heartbeat"]),
        ("heartbeatInterval(2); heartbeatInterval(-1);", []),
        ("try { heartbeatInterval(0); } catch (ArithmeticException e) { }", []),
    ],
)
def test_a_heartbeat_interval_is_shown(lfield, here, calls, message):
    desk, machine = run_text(f"coordinator Boss {{ init(string[] arg) {{ {calls} throw null; }} }}")
    (boss,) = desk.endings
    data = dump_file.encode("alpha", "why", 1 << 20, machine.team, ("alpha",), machine.program, boss.block)
    (lfield.folder / "boss.block").write_bytes(data)
    output = here("inspect", "boss.block", status=0)
    assert [line for line in output.out if line.startswith("heartbeat")] == message
