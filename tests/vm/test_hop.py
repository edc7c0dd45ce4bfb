"""Two machines without a network: a coordinator leaves one as bytes and continues in the other."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joined_hosts import JoinedHosts

from lfield.bytecode.program import Program
from lfield.errors import BlockError
from lfield.testing.golden import compile_text, run_until_idle
from lfield.vm.agent import TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.memory import layout

WANDERER = """
resource Post {
  string name; int stamps;
  init(string[] arg) { name = arg[0]; }
  portal stamp(Card card) emit Card {
    stamps = stamps + 1;
    card.text = card.text + name + i2s(stamps);
    return card;
  }
  portal refuse() { throw new DeviceTimeoutException("jammed"); }
}
class Card { public string text; public Card self; public Card() { text = ""; self = this; } }
coordinator Walker {
  Post here; Post there;
  init(string[] arg) {
    here = findPost("here"); there = findPost("there");
    Card card = new Card();
    int[] garbage = new int[5000];
    for (int i = 0; i < 3; i = i + 1) { card = lap(card, i); }
    print(card.text + " " + b2s(card.self == card));
    try { there.refuse(); }
    catch (DeviceException e) { here.stamp(card); print(e.type() + " " + e.message()); }
    print("hops " + i2s(hops()));
  }
  private Card lap(Card c, int i) {
    real kept = i * 0.5;
    c = there.stamp(c);
    c = here.stamp(c);
    c.text = c.text + f2s(kept);
    return c;
  }
}
"""


@cache
def program() -> Program:
    return compile_text(WANDERER)


TEAM = [
    TeamMember(0, "here", "Post", "resource", 0),
    TeamMember(1, "there", "Post", "resource", 1),
    TeamMember(2, "walker", "Walker", "coordinator", 0),
]


def two_hosts() -> JoinedHosts:
    return JoinedHosts(program(), TEAM)


def test_a_coordinator_keeps_its_state_and_identity_across_hops() -> None:
    hosts = two_hosts()
    hosts.run()
    assert sorted(hosts.printed) == sorted(
        ["there1here10.0there2here20.5there3here31.0 true", "DeviceTimeoutException jammed", "hops 8"]
    )


def test_a_hop_carries_live_data_only() -> None:
    hosts = two_hosts()
    hosts.run()
    # 5000 ints were garbage before the first hop: a dead slot still referred to them.
    assert max(map(len, hosts.images)) < 2000


def test_a_resumed_coordinator_gets_the_exception_at_its_portal_call() -> None:
    hosts = two_hosts()
    hosts.still()
    agent, target = hosts.places[0].departures.pop()
    assert target.id == "there"
    hosts.machines[0].resume(agent, "UnreachableResourceException", "no host there", "there")
    hosts.still()
    assert agent.ended == "died"
    assert agent.report.splitlines()[0] == "UnreachableResourceException: no host there"
    assert "at Walker.lap (golden.L:27)" in agent.report


@cache
def travelling() -> bytes:
    hosts = two_hosts()
    hosts.run()
    return hosts.images[2]


@pytest.mark.few(1)
@settings(max_examples=300)
@given(st.data())
def test_hostile_bytes_are_refused_or_harmless(data: st.DataObject) -> None:
    """Any change of a block by a peer leads to a BlockError, or a run that ends like any L program."""
    image = bytearray(travelling())
    for _ in range(data.draw(st.integers(1, 3))):
        word = data.draw(st.integers(0, len(image) // 8 - 1))
        old = int.from_bytes(image[8 * word : 8 * word + 8], "little", signed=True)
        new = data.draw(
            st.one_of(
                st.integers(-(2**63), 2**63 - 1),
                st.integers(0, len(image) // 8),
                st.integers(max(-(2**63), old - 3), min(2**63 - 1, old + 3)),
            )
        )
        image[8 * word : 8 * word + 8] = new.to_bytes(8, "little", signed=True)
    hosts = two_hosts()
    hosts.machines[0].agents.pop("walker")
    hosts.places[0].departures.clear()
    try:
        hosts.machines[1].unfreeze(hosts.machines[1].inject(TEAM[-1], bytes(image), AgentLimits()))
    except BlockError:
        return
    # A changed counter may make the route endless.
    for _ in range(100):
        for machine in hosts.machines:
            run_until_idle(machine, hosts.clock)
        if not hosts.carry():
            return


def with_word(image: bytes, word: int, value: int) -> bytes:
    """A block with another word."""
    return image[: 8 * word] + value.to_bytes(8, "little", signed=True) + image[8 * (word + 1) :]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda image: image[:-8], "its size does not match its header"),
        (lambda image: image[:-3], "are not a whole block"),
        (lambda image: b"\0" * 8 + image[8:], "wrong magic or version"),
        (lambda image: image[:8] + b"\0" * 32 + image[40:], "it belongs to another program"),
        (lambda image: image[: 8 * layout.W_SELF] + b"\x01" + image[8 * layout.W_SELF + 1 :], "roots"),
        (lambda image: with_word(image, layout.W_HOPS, (1 << 63) - 1), "its header is not valid"),
        (lambda image: with_word(image, layout.W_INTERVAL, -1), "its heartbeat interval is not valid"),
        (lambda image: with_word(image, layout.W_INTERVAL, 86_400_001), "its heartbeat interval"),
        (lambda image: with_word(image[:256], layout.W_TOP, 32), "its size does not match its header"),
    ],
)
def test_an_invalid_block_is_refused_with_the_reason(change, reason) -> None:  # type: ignore[no-untyped-def]
    hosts = two_hosts()
    with pytest.raises(BlockError, match=reason):
        hosts.machines[1].inject(TEAM[-1], change(travelling()), AgentLimits())
