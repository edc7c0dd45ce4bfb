"""A bit that flips in transit: the link closes, the hop is requested again, the mission's sum is right."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
from memory_network import MemoryLink

from lfield.errors import LfieldError
from lfield.net.coding.transfer_history import TransferHistory
from lfield.wire.codec import COMPRESSED, TRANSFER, TRANSFER_DELTA
from lfield.wire.framing import HEADER_SIZE

WALK = """
resource Post {
    string id;
    init(string[] arg) { id = arg[0]; }
    portal add(int sum) emit int { return sum + 1; }
}
coordinator Walker {
    init(string[] arg) {
        Post near = findPost("near");
        Post far = findPost("far");
        Post away = findPost("away");
        int sum = 0;
        for (int i = 0; i < ROUNDS; i = i + 1) sum = near.add(away.add(far.add(sum)));
        print("the sum is " + i2s(sum));
    }
}
"""
THREE_HOSTS = "//Post:near@alpha\n//Post:far@bravo\n//Post:away@charlie\n//Walker:walker@alpha\n"


def is_hop(link: MemoryLink, data: bytes) -> bool:
    """Whether the frame is a hop from alpha to bravo."""
    return (link.machine, link.other.machine) == ("alpha", "bravo") and data[HEADER_SIZE - 1] == TRANSFER


def is_delta(link: MemoryLink, data: bytes) -> bool:
    """Whether the frame is a hop from alpha to bravo that is sent as a delta."""
    here = link.machine, link.other.machine
    return here == ("alpha", "bravo") and data[HEADER_SIZE - 1] == TRANSFER_DELTA


def is_answer(link: MemoryLink, data: bytes) -> bool:
    """Whether the frame is bravo's answer to a hop: no other messages of this team are compressed."""
    return (link.machine, link.other.machine) == ("bravo", "alpha") and data[HEADER_SIZE - 1] == COMPRESSED


#: Every bit of the header and the first fields is tried, and then one of each byte, in turn.
CLOSE, THEN = 8 * 16, 9
#: A link that carries so many frames after a damage continues.
PASSED = 4


class FrameDamage:
    """Flips a bit of the frames that `wanted` selects, at a later place each time: one frame of each link."""

    def __init__(self, expected: Callable[[MemoryLink, bytes], bool]) -> None:
        self.wanted = expected
        self.place, self.flipped, self.last = 0, 0, 0
        #: Damages after which a link has carried PASSED more of these frames.
        self.harmless = self._passed = 0
        self._link: MemoryLink | None = None
        self._spare = True

    def __call__(self, link: MemoryLink, data: bytes) -> bytes:
        """The bytes as they arrive."""
        if not self.wanted(link, data):
            return data
        self.last = 8 * len(data)
        # A length that was increased is noticed when no more data comes: one damage per link.
        if link is self._link:
            self._passed += 1
            if self.wanted is is_delta and self._passed == PASSED:
                self.harmless += 1
                self.on_repaired()
            return data
        if self.place >= self.last:
            return data
        self._spare = not self._spare
        if self._spare:
            return data
        self._link, self._passed = link, 0
        damaged = bytearray(data)
        damaged[self.place // 8] ^= 1 << self.place % 8
        self.place += 1 if self.place < CLOSE else THEN
        self.flipped += 1
        return bytes(damaged)

    def on_repaired(self) -> None:
        """The link continues although a frame was damaged."""
        self._link = None


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("wanted", "rounds"), [(is_hop, 900), (is_delta, 1000), (is_answer, 500)], ids=["hop", "delta", "answer"]
)
async def test_a_flipped_bit_in_any_byte_of_a_hop_is_repaired(team, /, monkeypatch, wanted, rounds):
    if wanted is is_hop:
        monkeypatch.setattr(TransferHistory, "keep", lambda self, agent, payload, is_sent: None)
    damage, write = FrameDamage(wanted), MemoryLink.write
    monkeypatch.setattr(MemoryLink, "write", lambda link, data: write(link, damage(link, bytes(data))))
    finished, ended = MemoryLink.on_eof, []

    def note_end(link: MemoryLink, error: LfieldError | None) -> None:
        if link.machine == "alpha":
            ended.append(link.peer)
        finished(link, error)

    monkeypatch.setattr(MemoryLink, "on_eof", note_end)
    resend, repeated = MemoryLink._resend, []

    def note_repetition(link: MemoryLink, agent: str) -> None:
        """A damaged digest of the reference: the transfer is repeated whole."""
        resend(link, agent)
        repeated.append(agent)
        damage.on_repaired()

    monkeypatch.setattr(MemoryLink, "_resend", note_repetition)
    logs: dict[str, str] = {}

    team.network.latency = 0.1
    hosts = await team.up(team.mission(WALK.replace("ROUNDS", str(rounds)), THREE_HOSTS))
    while "walker:" not in "".join(logs.values()):
        await asyncio.sleep(10.0)
        logs.update((running.host.name, running.log) for running in hosts)
    print(f"{wanted.__name__}, a bit flipped in every byte: {len(ended)} / {damage.flipped} refused")
    assert set(ended) == {"bravo:8181"}
    # A flip in a delta may have no effect: a copy from another place has the same bytes, or the bit is
    # unused.
    assert damage.harmless <= 5 * (wanted is is_delta)
    assert len(ended) + len(repeated) + damage.harmless == damage.flipped
    assert damage.place >= damage.last > 0
    assert "Exception" not in "".join(logs.values())
    assert f"walker: the sum is {3 * rounds}\n" in "".join(logs.values())
