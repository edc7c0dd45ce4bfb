"""Acknowledgements of arrivals: which messages replace or carry them, and their delay."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from lfield.host.migration.delayed_acks import ACK_DELAY, DelayedAcks
from lfield.hybrid_clock import HybridClock
from lfield.replication.transfer.effects import Send
from lfield.wire.coordinator_messages import Transfer, TransferAccepted

PROGRAM = """
resource Echo {
    init(string[] arg) { }
    portal say() { }
}
coordinator Visitor {
    init(string[] arg) {
        Echo near = findEcho("near");
        Echo far = findEcho("far");
        for (int round = 0; round < 50; round += 1) { near.say(); far.say(); }
        print("made " + i2s(hops()) + " hops");
    }
}
"""
DEPLOYMENT = "//Echo:near@alpha\n//Echo:far@bravo\n//Visitor:visitor@alpha\n"


class Host:
    """Sends acknowledgements on a manual clock."""

    def __init__(self) -> None:
        self.now, self.sent, self.held = 10.0, [], []
        self.answers = DelayedAcks(self.send, lambda: self.now, HybridClock(0.0, 0.0))

    def send(self, answer: Send) -> None:
        self.held.append(answer.message.held)
        self.sent.append(Send(answer.host, replace(answer.message, held=0.0, stamp=0)))

    def arrives(self, host: str, agent: str = "tom", generation: int = 1, sequence: int = 1) -> Send:
        accepted = TransferAccepted(agent, generation, sequence)
        answer = Send(host, accepted)
        self.answers.add(answer, accepted)
        return answer

    def leaves(self, host: str, agent: str = "tom", generation: int = 1) -> None:
        self.answers.on_sending(host, Transfer(agent, generation, 2, 2, b"p" * 32, 7, 0))


def test_an_acknowledgement_is_sent_after_a_short_delay():
    host = Host()
    answer = host.arrives("bravo")
    assert host.answers.due == host.now + ACK_DELAY
    host.answers.on_tick(host.now + ACK_DELAY / 2)
    assert host.sent == []
    host.now += ACK_DELAY
    host.answers.on_tick(host.now)
    assert host.sent == [answer]
    assert host.held == [pytest.approx(ACK_DELAY)]
    assert host.answers.due is None


def test_a_return_replaces_the_acknowledgement_and_another_hop_sends_it_first():
    host = Host()
    host.arrives("bravo")
    host.leaves("bravo")
    assert (host.sent, host.answers.due) == ([], None)
    answer = host.arrives("bravo")
    host.leaves("carol")
    assert host.sent == [answer]


def test_another_start_of_a_coordinator_does_not_replace_it():
    host = Host()
    answer = host.arrives("bravo", generation=1)
    host.leaves("bravo", generation=2)
    # The acknowledgement is sent together with it.
    assert host.sent == [answer]


def test_a_message_to_a_host_carries_the_acknowledgements_for_it():
    host = Host()
    tom, ann, eve = (
        host.arrives(at, agent) for at, agent in (("bravo", "tom"), ("carol", "ann"), ("bravo", "eve"))
    )
    host.answers.flush("bravo")
    assert host.sent == [tom, eve]
    host.answers.flush()
    assert host.sent == [tom, eve, ann]


def test_a_later_arrival_of_the_same_start_does_not_delay_the_first():
    host = Host()
    first, second = host.arrives("bravo", sequence=1), host.arrives("carol", sequence=3)
    assert host.sent == [first]
    host.now += ACK_DELAY
    host.answers.on_tick(host.now)
    assert host.sent == [first, second]


@pytest.mark.parametrize("keeps", [False, True], ids=["without journals", "with journals"])
async def test_hops_back_and_forth_need_few_acknowledgements(team, /, keeps):
    alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT), "alpha", "bravo", keeps=keeps)
    await team.until(lambda: "made 99 hops" in alpha.log + bravo.log)
    # Of 99 transfers; a busy computer may keep a few for longer than the delay.
    assert team.network.sent["Transfer"] == 99
    assert team.network.sent["TransferAccepted"] <= 20
