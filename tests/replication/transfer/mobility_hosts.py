"""One host of the mobility core, and its sent messages."""

from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Effect, TransferRefusal
from lfield.wire.coordinator_messages import CoordinatorState, Transfer
from lfield.wire.messages import Hello

PROGRAM = b"p" * 32
TOUR = "Tour:one"


class Host:
    """One machine with the list of admitted blocks and the answer to the next ones."""

    def __init__(self, name: str, incarnation: int = 1, max_block: int = 1000) -> None:
        self.name, self.incarnation, self.max_block = name, incarnation, max_block
        self.injected: list[tuple[int, bytes]] = []
        self.refusal: TransferRefusal | None = None
        self.mobility = Mobility(self.hello(), peers=["a", "b", "c"], agents=[TOUR], unreachable_after=10.0)

    def inject(self, header: Transfer, block: bytes) -> TransferRefusal | None:
        if self.refusal is None:
            self.injected.append((header.sequence, bytes(block)))
        return self.refusal

    def receive(self, host: str, header: Transfer, block: bytes) -> list[Effect]:
        return self.mobility.on_transfer(host, header, block, self.inject)

    def hello(self, *known: CoordinatorState) -> Hello:
        return Hello("host", self.name, self.incarnation, PROGRAM, PROGRAM, self.max_block, list(known))

    def greeting(self) -> Hello:
        return self.hello(*self.mobility.known_states())

    def known(self, generation: int = 1) -> CoordinatorState:
        return next(k for k in self.mobility.known_states() if k.generation == generation)


def seal(sequence: int) -> bytes:
    return b"block %d" % sequence


def transfer(sequence: int, generation: int = 1, receiver: int = 1, **other) -> Transfer:
    fields = {"agent": TOUR, "hops": 1, "program": PROGRAM, "size": 7} | other
    return Transfer(generation=generation, sequence=sequence, receiver_memory=receiver, **fields)
