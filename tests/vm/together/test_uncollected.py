"""Blocks that migrate without a collection: their garbage is valid, and they do not grow."""

from __future__ import annotations

import pytest
from joined_hosts import JoinedHosts

from lfield.testing.golden import compile_text
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.memory import collector

#: Methods that call one another, hop, throw and leave garbage, chosen by random numbers of the L program.
WANDERER = """
class Note { public int number; public Note next; public Note(int n, Note rest) { number = n; next = rest; } }
resource Post {
    init(string[] arg) { }
    portal visit(int n) emit int { return n + 1; }
    portal give(int n) emit Note { return new Note(n, new Note(n, null)); }
}
coordinator Boss {
    int dice; Post[] posts; Note kept; int visits;

    init(string[] arg) {
        dice = SEED;
        posts = findPost();
        for (int i = 0; i < 12; i = i + 1) {
            try { kept = some(null, 4); } catch (Exception e) { visits = visits + 1; }
        }
        print("visits " + i2s(visits));
    }

    private int roll(int sides) {
        dice = (dice * 1103515245 + 12345) % 2147483648;
        return dice / 65536 % sides;
    }

    private Note some(Note given, int deep) {
        Note mine = given;
        for (int i = 0; i < 4; i = i + 1) {
            int what = roll(9);
            if (what < 3) visits = visits + posts[roll(posts.length())].visit(what) - what;
            if (what == 3) mine = posts[roll(posts.length())].give(deep);
            if (what == 4) mine = new Note(deep, mine);
            if (what == 5 && deep > 0) mine = some(mine, deep - 1);
            if (what == 6 && deep > 0) { int n = other(deep - 1); visits = visits + n - n; }
            if (what == 7 && deep < 3) throw new Exception("enough");
            if (what == 8) kept = mine;
        }
        return mine;
    }

    private int other(int deep) {
        try { return some(kept, deep).number; }
        catch (NullException e) { return 0; }
        finally { visits = visits + posts[roll(posts.length())].visit(1) - 1; }
    }
}
"""


def travelled(seed: int, packet: int) -> tuple[list[str], int, int, int]:
    """The output, the hops, the hops without a collection, and the largest block in bytes.

    Blocks of up to `packet` words are not collected.
    """
    joined = JoinedHosts(compile_text(WANDERER.replace("SEED", str(seed))), 3)
    largest, left, same = 0, 0, 0
    pack = Machine.pack

    def noted(machine: Machine, agent: Agent) -> memoryview:
        nonlocal largest, left, same
        data = agent.block.data
        image = pack(machine, agent)
        largest, left, same = max(largest, len(image)), left + 1, same + (agent.block.data is data)
        return image

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collector, "SMALL_BLOCK_WORDS", packet)
        patch.setattr(Machine, "pack", noted)
        joined.run()
    return joined.printed, left, same, largest


@pytest.mark.few(1)
@pytest.mark.parametrize("first", range(0, 20, 5))
def test_an_uncollected_block_arrives_from_any_point_with_any_garbage(first: int) -> None:
    hops = uncollected = 0
    for seed in range(first, first + 5):
        printed, left, none, _ = travelled(seed, 0)
        assert none == 0
        again, as_many, some, _ = travelled(seed, 1 << 20)
        assert (again, as_many) == (printed, left)
        hops, uncollected = hops + left, uncollected + some
    assert uncollected > hops // 10 > 2


def test_an_uncollected_block_carries_less_than_a_packet_of_garbage() -> None:
    """A block without new objects arrives with the same size."""
    for seed in range(5):
        *_, least = travelled(seed, 0)
        *_, most = travelled(seed, collector.SMALL_BLOCK_WORDS)
        assert most <= max(least, 8 * collector.SMALL_BLOCK_WORDS)
