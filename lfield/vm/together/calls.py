"""The calls that were begun on this host: what became of them, and who hears of it (decision 46)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lfield.vm.agent import Agent
from lfield.vm.begun import Begun, Key
from lfield.vm.cancelling import Cancelling
from lfield.vm.memory.soundness import Soundness
from lfield.vm.memory.tickets import under_way
from lfield.vm.scheduler import Scheduler


class BegunCalls:
    """Keeps `scheduler.begun`: from the beginning of a call until its coordinator has fetched it."""

    def __init__(self, scheduler: Scheduler, cancelling: Cancelling, soundness: Soundness) -> None:
        self._scheduler, self._cancelling, self._soundness = scheduler, cancelling, soundness

    def calls(self) -> list[Begun]:
        """Those that were not yet fetched, in the order of their beginning."""
        return list(self._scheduler.begun.values())

    def fetched(self, agent: Agent) -> list[Key]:
        """Those that the coordinator has fetched here since this was last asked; each is told once.

        What the host has kept of them may go when the block with their results is on the disk, here or where
        it went.
        """
        keys, agent.fetched = agent.fetched, []
        return keys

    def kept(self, key: Key) -> None:
        """What came back (`World.came_back`) is kept: whoever waits here for it goes on.

        May be called from there.
        """
        begun = self._scheduler.begun.get(key)
        if begun is None or begun.kept:
            return
        begun.kept = True
        waiter, begun.waiter = begun.waiter, None
        if waiter is not None:
            self._scheduler.turns.next(*waiter)

    def restore(self, calls: Iterable[Begun]) -> None:
        """What the host has kept in an earlier life; before any coordinator is restored.

        What ran then is lost, and what cannot be read: whoever fetches it gets a RestartException.
        """
        for begun in calls:
            begun.kept = True
            if begun.state == "running" or not self._soundness.is_parcel(
                begun.parcel, begun.state == "thrown"
            ):
                begun.state = "lost"
            self._scheduler.begun[begun.key] = begun

    def forget(self, keys: Iterable[Key]) -> None:
        """Nobody will fetch them; portals that still run for them go on alone."""
        for key in keys:
            if begun := self._scheduler.begun.pop(key, None):
                begun.dropped = True

    def cancel(self, agent: str, below: int | None, reason: str) -> list[Key]:
        """Those of the starts of a coordinator before `below` (None: of all) are cancelled and forgotten.

        Their portals get a CancelledException with this reason, and what they give is dropped. Returns which
        calls they were.
        """
        found = [begun for begun in self._of(agent) if below is None or begun.generation < below]
        self._cancel(found, reason)
        return [begun.key for begun in found]

    def _cancel(self, calls: list[Begun], reason: str) -> None:
        self.forget([begun.key for begun in calls])
        for begun in calls:
            resource = self._scheduler.agents.get(begun.resource)
            if begun.state == "running" and resource is not None:
                self._cancelling.call(resource, begun.call, reason)

    def tidy_up(self, agent: Agent) -> None:
        """A coordinator has come: what it has begun here and waits for no more is cancelled and forgotten.

        Its block has ended without it, since this host could not be reached.
        """
        if not self._scheduler.begun:
            return
        begun = [call for call in self._of(agent.id) if call.generation == agent.generation]
        waited = under_way(agent.block) if begun else set()
        left = [call for call in begun if call.number not in waited]
        self._cancel(left, f"the together of {agent.id} has ended without it")
        agent.fetched += [call.key for call in left]

    def end(self, agent: str, kind: str, reason: str) -> None:
        """Those of a coordinator that run come back at once with an exception, as `Machine.abandon` does it.

        Their portals go on alone, may command no device, and what they give is dropped.
        """
        for begun in list(self._of(agent)):
            if begun.state == "running":
                self._scheduler.calls.pop(begun.call, None)
                message = f"{reason} ({begun.resource}.{begun.portal})"
                self._scheduler.fail_begun(begun, kind, message, begun.resource)

    def stop_waiting(self, agent: Agent) -> bool:
        """A coordinator waits no more for what it has begun here; false when it did not."""
        waited = [b for b in self._of(agent.id) if b.waiter is not None and b.waiter[0] is agent]
        for begun in waited:
            begun.waiter = None
        return bool(waited)

    def _of(self, agent: str) -> Iterator[Begun]:
        return (begun for begun in self._scheduler.begun.values() if begun.agent == agent)
