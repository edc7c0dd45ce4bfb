"""Several machines without a network, as in `joined_hosts`, with reservable resources."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from joined_hosts import HostWorldStub, JoinedHosts

from lfield.bytecode.program import Program
from lfield.testing.golden import compile_text
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import AgentLimits, Trap

POST = """
class Own { public int n; public Own(int n) { this.n = n; } }
class Pair coordinator specific {
  private Post left; private Post right;
  public Pair(Post l, Post r) { left = l; right = r; }
  public int both() { return left.count() + right.count(); }
}
resource Post {
  int done;
  init(string[] arg) { }
  portal work(real s) emit real { done = done + 1; sleep(s); return s; }
  portal count() emit int { return done; }
  portal own(int n) { throw new Own(n); }
  portal heed(real s) { try { sleep(s); } finally { print("heeded"); } }
}
coordinator Boss {
  init(string[] arg) { Post[] r = findPost(); %s }
  private Post[] reversed() { Post[] r = findPost(); return new Post[] {r[2], r[1], r[0]}; }
  private int counted(Post p) { return p.count(); }
  private int early(Post p) { reserve (p) { while (true) { return p.count(); } } }
}
"""


@cache
def program(body: str) -> Program:
    return compile_text(POST % body)


class ReservationBook:
    """The reservations of all hosts: a resource that is neither `busy` nor `refused` is granted at once.

    `log` has the requests, in order: `take r1`, `drop r1 7`, `serve r1 7`.
    """

    def __init__(self) -> None:
        self.numbers = iter(range(7, 1000))
        self.held: dict[str, int] = {}
        self.busy: set[str] = set()
        self.refused: set[str] = set()
        self.nested: list[str] = []
        self.log: list[str] = []


class ReservingWorld(HostWorldStub):
    """A stub of one host that asserts the contract of the machine."""

    def __init__(self, book: ReservationBook) -> None:
        super().__init__()
        self.book = book

    def acquire_reservation(self, agent: Agent, resource: TeamMember, *, nested: bool) -> int:
        assert agent.frozen
        assert resource.id in self.machine.agents
        book = self.book
        book.log.append(f"take {resource.id}")
        if nested:
            book.nested.append(resource.id)
        if resource.id in book.refused:
            raise Trap("ReservedException", f"{resource.id} is reserved by pilot", resource.id)
        if resource.id in book.busy:
            return 0
        # A host with a journal does the same: earlier readings of the block are invalid then.
        self.machine.pack(agent)
        if resource.id not in book.held:
            book.held[resource.id] = next(book.numbers)
        self.machine.agents[resource.id].reserved = True
        return book.held[resource.id]

    def release_reservations(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        assert not agent.frozen
        assert held
        for resource, number in held:
            self.book.log.append(f"drop {resource.id} {number}")
            if self.book.held.get(resource.id) == number:
                del self.book.held[resource.id]

    def may_serve(self, agent: Agent, resource: TeamMember, number: int) -> bool:
        assert agent.frozen
        self.book.log.append(f"serve {resource.id} {number}")
        if resource.id in self.book.busy:
            return False
        if number != self.book.held.get(resource.id, 0):
            lost = f"{resource.id} was reserved by pilot since"
            raise Trap("ReservationLostException" if number else "ReservedException", lost, resource.id)
        return True


class ReservingHosts(JoinedHosts):
    """`JoinedHosts` with one book for all hosts."""

    def __init__(self, program: Program, hosts: int = 3, limits: AgentLimits | None = None) -> None:
        self.book = ReservationBook()
        super().__init__(program, hosts, limits=limits, place=lambda: ReservingWorld(self.book))

    @property
    def served(self) -> list[str]:
        """The requested calls, with their reservation numbers."""
        return [line.removeprefix("serve ") for line in self.book.log if line.startswith("serve")]

    @property
    def kept(self) -> list[str]:
        """The acquired and released reservations, in order."""
        return [line for line in self.book.log if not line.startswith("serve")]

    @property
    def death(self) -> str:
        """The reason of the coordinator's death, '' for none."""
        ended = [agent for place in self.places for agent in place.endings]
        return ended[0].report.splitlines()[0] if ended and ended[0].ended == "died" else ""


def ran(body: str) -> ReservingHosts:
    """A mission that has completed."""
    joined = ReservingHosts(program(body))
    joined.run()
    assert not any("boss" in machine.agents for machine in joined.machines)
    return joined
