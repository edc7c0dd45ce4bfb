"""The sender's half of a hop: RUN, FROZEN, PREPARED, MOVED, and back to RUN after a refusal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.mobility.effects import Departed, Effect, InDoubt, Resume, Send, SendTransfer
from lfield.wire.coordinators import NEVER_ARRIVED, SUPERSEDED, Accepted, Inquire, Refused, Transfer
from lfield.wire.fields import clip
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lfield.mobility.copies import Copies, Copy
    from lfield.mobility.endings import Endings
    from lfield.wire.coordinators import Known
    from lfield.wire.framing import Buffer

#: The L exceptions a refused hop ends in (appendix I names the first and the last).
UNREACHABLE = "UnreachableResourceException"
RESTARTED = "RestartException"
#: What is known of a call that a restart has come between.
UNBEGUN, PERHAPS = "this call has not begun", "this call may have begun"
LIMIT = "LimitException"
#: Why a host that somebody has paused takes nobody in.
PAUSED = "the mission is paused there"


class Departures:
    """The copies of one host that want to leave it."""

    def __init__(
        self,
        own: Hello,
        copies: Copies,
        links: Mapping[str, Hello],
        endings: Endings,
        unreachable_after: float,
    ) -> None:
        self._own, self._copies, self._links, self._endings = own, copies, links, endings
        self._unreachable_after = unreachable_after
        #: The hosts that can keep nothing now, with the reason of each, while there is a link.
        self._full: dict[str, str] = {}
        #: The hosts that were asked for a sign of life: nothing is sent there before it has come.
        self._asked: set[str] = set()

    def depart(self, copy: Copy, host: str, seal: Callable[[int], Buffer], now: float) -> list[Effect]:
        """A running copy wants to go to `host`."""
        copy.target, copy.seal, copy.deadline = host, seal, now + self._unreachable_after
        return self._send(copy)

    def linked(self, peer: Hello) -> list[Effect]:
        """Go on with the copies that wait for this host. Whether it has room it says anew."""
        self._full.pop(peer.host, None)
        self._asked.discard(peer.host)
        effects: list[Effect] = []
        for copy in self._copies:
            if copy.target == peer.host and (copy.state in ("FROZEN", "PREPARED") or copy.gave_way):
                # What is restored is not in the machine yet: it could not go on.
                effects += [] if copy.restored and copy.seal is None else self._take_up(copy, peer)
        return effects

    def questions(self) -> list[tuple[Send, bool]]:
        """What is to be asked through other hosts, since the link is gone or its host does not know it any
        more; and whether the copy is in doubt."""
        waiting = (copy for copy in self._copies if copy.awaits_answer)
        return [
            (_question(copy), bool(copy.doubt))
            for copy in waiting
            if copy.target not in self._links or self._links[copy.target].remembers != copy.memory
        ]

    def unlinked(self, host: str) -> None:
        """The link to a host is gone, and with it what that has said of its room: it may be dead."""
        self._full.pop(host, None)
        self._asked.discard(host)

    def ask(self, host: str) -> bool:
        """Whether a linked host is to be asked for a sign of life: copies wait for it as without a link.

        It is not where nothing could be sent to it anyway.
        """
        if host not in self._full:
            self._asked.add(host)
        return host in self._asked

    def answered(self, host: str) -> list[Effect]:
        """The sign of life has come."""
        self._asked.discard(host)
        return self.room(host, self._full.get(host, ""))

    def woken(self, copy: Copy, now: float) -> list[Effect]:
        """A copy that was sent before this host was started again is in the machine."""
        copy.deadline = now + self._unreachable_after
        peer = self._links.get(copy.target)
        return [] if peer is None else self._take_up(copy, peer)

    def room(self, host: str, trouble: str) -> list[Effect]:
        """Whether a host can keep what is sent there: else nothing is, and copies wait as without a link."""
        self._full.pop(host, None)
        if trouble:
            self._full[host] = trouble
            return []
        waiting = [copy for copy in self._copies if copy.target == host and copy.state == "FROZEN"]
        return [effect for copy in waiting for effect in self._send(copy)]

    def accepted(self, host: str, message: Accepted) -> list[Effect]:
        """The receiver has it, or it has gone on from there: the commit point, seen from here.

        Any host may know that it has gone on.
        """
        copy = self._under_way(message)
        return [] if copy is None else self.moved(copy, message.held)

    def refused(self, host: str, message: Refused, now: float) -> list[Effect]:
        """The receiver has it not, and never will under this number."""
        copy = self._under_way(message)
        if copy is None or (copy.target != host and message.kind != SUPERSEDED):
            return []
        if copy.gave_way and message.kind != SUPERSEDED:
            copy.end("lost", f"{host} did not take it, and the copy here had given way", self._own.host)
            return []
        copy.doubt = ""
        if message.kind == SUPERSEDED:
            return self._endings.stop(copy, message.reason, host)
        if message.kind != NEVER_ARRIVED:
            return self._resume(copy, message.kind, message.reason)
        if now < copy.deadline:
            return self._send(copy)
        return self._resume(copy, UNREACHABLE, f"the link to {host} broke on the way and came back too late")

    def learn(self, host: str, memory: int, known: Known) -> list[Effect]:
        """Whether what `host` knows proves that a copy under way from here has arrived.

        Numbers beyond its own are given out only by the copy that it became.
        """
        copy = self._copies.find(known.agent, known.generation)
        if copy is None or not copy.is_unanswered:
            return []
        if self._copies.kept and (host, memory) == (copy.target, copy.memory):
            # What it says of itself may not be on its disk yet. It answers for that transfer when it is.
            return []
        arrived = known.sequence == copy.sequence and known.state in ("RUN", "FROZEN")
        return self.moved(copy) if arrived or known.sequence > copy.sequence else []

    def moved(self, copy: Copy, held: float = 0.0) -> list[Effect]:
        """The copy lives elsewhere; the block stays as its shadow."""
        copy.state, copy.seal, copy.doubt, copy.restored = "MOVED", None, "", False
        departed = Departed(copy.agent, copy.generation, copy.sequence, copy.target, held)
        return [departed, *self._copies.keep_soon(copy)]

    def give_up(self, copy: Copy) -> bool:
        """Whether a copy that wants away stays and goes on: not when something may have been sent."""
        if copy.state != "FROZEN":
            return False
        copy.state, copy.seal = "RUN", None
        if not self._copies.kept:
            copy.block = None
        return True

    def postpone(self, now: float) -> None:
        """Whatever waits for a host or its answer has all its time again."""
        for copy in self._copies:
            if copy.state in ("FROZEN", "PREPARED"):
                copy.deadline = now + self._unreachable_after

    def overdue(self, copy: Copy) -> list[Effect]:
        """The time of a departure is over: nothing was sent, so resume; or something was, so doubt.

        Who waits for a host that somebody has paused waits as long as that is linked and paused.
        """
        if copy.state == "FROZEN" and self._full.get(copy.target) == PAUSED:
            copy.deadline += self._unreachable_after
            return []
        host, seconds = copy.target, f"{self._unreachable_after:g} s"
        if copy.state == "FROZEN":
            why = f"could not be reached within {seconds}; is it up?"
            if host in self._full:
                why = f"could not keep {copy.agent} within {seconds}: {self._full[host]}"
            return self._resume(copy, UNREACHABLE, f"{host} {why}")
        if copy.state == "PREPARED" and not copy.doubt:
            return self._doubt(
                copy,
                f"{host} has not said within {seconds} whether it took {copy.agent}; still waiting for it",
            )
        return []

    def _send(self, copy: Copy) -> list[Effect]:
        """Send under the next number, or wait frozen for a link."""
        peer = self._links.get(copy.target)
        if peer is None or copy.target in self._full or copy.target in self._asked:
            copy.state = "FROZEN"
            return []
        copy.sequence += 1
        copy.refusal = None
        copy.block = block = self._sealed(copy)
        size = len(block)
        if size > peer.max_block:
            reason = f"{copy.agent} has {size} bytes and {peer.host} takes at most {peer.max_block}"
            return self._resume(copy, LIMIT, reason)
        copy.state, copy.memory = "PREPARED", peer.remembers
        header = Transfer(
            copy.agent,
            copy.generation,
            copy.sequence,
            copy.hops + 1,
            self._own.program,
            peer.remembers,
            size,
        )
        return [*self._copies.keep(copy), SendTransfer(peer.host, header, block)]

    def _sealed(self, copy: Copy) -> Buffer:
        """The block to send. What is kept must stay as it is when the copy goes on here after all."""
        assert copy.seal is not None
        block = copy.seal(copy.sequence)
        return bytes(block) if self._copies.kept else block

    def _take_up(self, copy: Copy, peer: Hello) -> list[Effect]:
        """The link is back for a copy that waits."""
        if copy.state == "FROZEN":
            return self._send(copy)
        if peer.remembers == copy.memory:
            return [_question(copy)]
        if copy.gave_way:
            return []
        return self._doubt(
            copy,
            f"{peer.host} was restarted before it said whether it took {copy.agent}; "
            "the copy here stays frozen, since another may be running",
        )

    def _doubt(self, copy: Copy, reason: str) -> list[Effect]:
        if copy.doubt == reason:
            return []
        copy.doubt = reason
        return [InDoubt(copy.agent, copy.generation, copy.sequence, copy.target, reason)]

    def _resume(self, copy: Copy, kind: str, reason: str) -> list[Effect]:
        copy.state, copy.seal = "RUN", None
        if not self._copies.kept:
            copy.block = None
        if copy.restored:
            kind, reason = RESTARTED, f"{self._own.host} was started again; {UNBEGUN}: {reason}"
            copy.restored = False
        return [Resume(copy.agent, copy.generation, copy.sequence, kind, clip(reason))]

    def _under_way(self, answer: Accepted | Refused) -> Copy | None:
        """The copy that an answer is about, if it still waits for that answer."""
        copy = self._copies.find(answer.agent, answer.generation)
        if copy is None or not copy.is_unanswered:
            return None
        return copy if copy.sequence == answer.sequence else None


def _question(copy: Copy) -> Send:
    return Send(copy.target, Inquire(copy.agent, copy.generation, copy.sequence, copy.memory))
