"""Results that exist before the end of their `together`: tickets without a call, which migrate."""

from __future__ import annotations

from functools import cache

import pytest
from joined_hosts import JoinedHosts

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import ARRAY, STRING, Program, Quad, TypeRecord, encode_quads
from lfield.bytecode.verifier import verify
from lfield.errors import BlockError
from lfield.testing.golden import compile_text
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.inspection.block_view import view
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block

#: `r[0].text()` is replaced by the result of an offer that ran in place: the string in `made`.
PLACED = """
resource Post {
  init(string[] arg) { }
  portal text() emit string { return "never called"; }
  portal work(boolean fails) { sleep(1.0); if (fails) throw new DeviceException("stuck"); }
}
coordinator Boss {
  init(string[] arg) {
    work(findPost(), "settled", arg.length() > 5); work(findPost(), "lost", arg.length() < 5);
  }
  private void work(Post[] r, string made, boolean fails) {
    Post first = r[0]; Post second = r[1];
    string[] s = new string[2];
    s[1] = "before";
    try { together { s[1] = first.text(); second.work(fails); } }
    catch (DeviceException e) { print(e.message()); }
    print(s[1]);
  }
}
"""


@cache
def placed() -> Program:
    """The program with its first `begin` replaced by a `settle`."""
    source = compile_text(PLACED)
    core, quads = source.core, list(source.quads)
    pc = next(i for i, quad in enumerate(quads) if quad.op == BY_NAME["begin"].code)
    quads[pc - 1] = Quad(BY_NAME["push"].code, 2, 0, 0)
    quads[pc] = Quad(BY_NAME["settle"].code, core.types.index(TypeRecord(ARRAY, STRING)), 0, 0)
    settled_core = core.__class__(
        core.types, core.constants, core.classes, core.methods, core.device_calls,
        encode_quads(quads),
    )  # fmt: skip
    program = Program(settled_core, source.debug, source.digest)
    verify(program)
    return program


def test_an_immediate_result_is_assigned_after_all_calls_return() -> None:
    joined = JoinedHosts(placed(), 2)
    joined.run(until=0.5)
    frame_locals = view(joined.boss[1].block, joined.program, [member.id for member in joined.team])
    calls = [call for frame in frame_locals.threads[0].frames for call in frame.calls]
    assert calls == ["an offer that was executed synchronously returned", "r1.work() started"]
    joined.run()
    assert joined.printed[-3:] == ["settled", "stuck", "before"]


@cache
def travelled() -> bytes:
    """The block on its way to the second host, with one result and one call."""
    found: list[bytes] = []

    class Noting(JoinedHosts):
        def leave(self, source, agent, target):  # type: ignore[no-untyped-def]
            found.append(bytes(self.machines[source].pack(agent)))
            super().leave(source, agent, target)

    Noting(placed(), 2).run()
    return found[0]


@pytest.mark.parametrize(
    ("word", "changed", "reason"),
    [
        (layout.TICKET_STATE, layout.TICKET_COLLECTED, "not refer to a resource"),
        (layout.TICKET_STATE, layout.TICKET_STARTED, "not refer to a resource"),
        (layout.TICKET_STATE, layout.TICKET_CANCELLING, "not refer to a resource"),
        (layout.TICKET_METHOD, 1, "not refer to a resource"),
        (layout.TICKET_GENERATION, 1, "not refer to a resource"),
        (layout.TICKET_INDEX, 2, "not an element"),
        (layout.TICKET_ARRAY, 0, "not an element"),
        (layout.TICKET_VALUE, None, "of its type"),
        (layout.TICKET_THROWN, None, "of its type"),
    ],
)
def test_a_changed_ticket_without_a_call_is_refused(word: int, changed: int | None, reason: str) -> None:
    image = bytearray(travelled())
    block = Block(image, len(image) // 8, len(image) // 8)
    place = block.heap
    while block.w[place] & 0xFF != layout.TICKET or not block.w[place + layout.TICKET_VALUE]:
        place += block.w[place] >> 32
    assert not block.w[place + layout.TICKET_PROXY]
    block.w[place + word] = block.w[place + layout.TICKET_ARRAY] if changed is None else changed
    joined = JoinedHosts(placed(), 2)
    joined.machines[0].agents.pop("boss").ended = "dropped"
    with pytest.raises(BlockError, match=reason):
        joined.machines[1].inject(joined.team[2], bytes(image), AgentLimits())
