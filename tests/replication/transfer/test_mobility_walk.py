"""Long random walks through the same world as the property test: without shrinking, with many more steps.

The walks find broken machines whose fault needs a rare sequence.
"""

import random

import pytest
from mobility_world import TIMEOUT, World

from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Send
from lfield.wire.coordinator_messages import NEVER_ARRIVED, TransferQuery, TransferRefused


def walk(machine: type[Mobility], seed: int, steps: int = 150) -> World:
    """One walk, checked after every step and after the network is healed."""
    rng = random.Random(seed)
    world = World("abc", {"Tour:one": "a", "Tour:two": "b"}, machine)
    for pair in world.unlinked_pairs():
        world.connect(*pair)
    weights = {
        deliver: 10,
        wander: 4,
        connect: 3,
        flap: 2,
        lose: 1,
        repeat: 1,
        wait: 1,
        notice: 1,
        disturb: 0.3,
    }
    actions, odds = list(weights), list(weights.values())
    for action in rng.choices(actions, odds, k=steps):
        action(world, rng)
        world.check()
    world.heal()
    world.check_healed()
    return world


def walks(machine: type[Mobility], seeds: range) -> int:
    """Many walks; returns the number of hops."""
    return sum(sum(walk(machine, seed).injected.values()) for seed in seeds)


def deliver(world: World, rng: random.Random) -> None:
    if world.packets:
        late = rng.random() < 0.5
        world.deliver(world.packets.pop(rng.randrange(len(world.packets)) if late else 0))


def wander(world: World, rng: random.Random) -> None:
    running = [(host, start) for host in world.hosts.values() for start in host.running]
    if running:
        host, start = rng.choice(running)
        world.work(host, start)
        world.wander(host, start, rng.choice([name for name in world.names if name != host.name]))


def connect(world: World, rng: random.Random) -> None:
    pairs = world.unlinked_pairs()
    if pairs:
        world.connect(*rng.choice(pairs))


def flap(world: World, rng: random.Random) -> None:
    one, other = rng.sample(world.names, 2)
    world.cut(one, other)
    world.notice(one, other)
    if rng.random() < 0.8:
        world.notice(other, one)
        world.connect(one, other)


def lose(world: World, rng: random.Random) -> None:
    if world.packets:
        world.packets.pop(rng.randrange(len(world.packets)))


def repeat(world: World, rng: random.Random) -> None:
    if world.packets:
        world.packets.append(rng.choice(world.packets))


def wait(world: World, rng: random.Random) -> None:
    world.advance(rng.choice([1.0, TIMEOUT / 2, TIMEOUT + 1]))


def notice(world: World, rng: random.Random) -> None:
    world.notice(*rng.sample(world.names, 2))


def disturb(world: World, rng: random.Random) -> None:
    """End a life: a kill, a restart, a coordinator's end, a full machine."""
    name = rng.choice(world.names)
    host = world.hosts.get(name)
    if host is None:
        world.boot(name)
    elif rng.random() < 0.3:
        world.kill(name)
    elif rng.random() < 0.5:
        host.full = not host.full
    elif host.running:
        world.finish(host, rng.choice(sorted(host.running)), rng.choice(["done", "died"]))


@pytest.mark.few(4)
@pytest.mark.parametrize("start", range(0, 1000, 100))
def test_random_walks_keep_all_promises(start):
    assert walks(Mobility, range(start, start + 100)) > 500, "the walks must contain hops"


class ForgetsItsAnswer(Mobility):
    """Answers 'never arrived' and does not store the answer."""

    def on_message(self, host, message, now):
        if isinstance(message, TransferQuery):
            copy = self._copies.find(message.agent, message.generation)
            if copy is None or message.sequence > copy.sequence:
                answer = TransferRefused(
                    message.agent, message.generation, message.sequence, NEVER_ARRIVED, ""
                )
                return [Send(host, answer)]
        return super().on_message(host, message, now)


class TrustsARestartedReceiver(Mobility):
    """Accepts the answer of a restarted receiver about its earlier incarnation."""

    def on_linked(self, peer):
        for copy in self._copies:
            if copy.state == "PREPARED" and copy.target == peer.host:
                copy.receiver_memory = peer.state_id
        return super().on_linked(peer)


@pytest.mark.parametrize("machine", [ForgetsItsAnswer, TrustsARestartedReceiver])
def test_a_protocol_that_is_broken_after_restarts_is_found(machine):
    with pytest.raises(AssertionError, match=r"live copies|injected|old copy"):
        walks(machine, range(3000))
