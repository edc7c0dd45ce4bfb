"""`start`, `stop`, `awaitEnd` and `running`: a coordinator visits the home of another coordinator, which
decides.

The visit is a hop as for a portal call: it is durable and numbered, and the limits of `within` apply to it.
The home alone counts the starts of its coordinators, so two requests never start a coordinator twice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from lfield.vm.agent import Agent, TeamMember
from lfield.vm.deadlines import Deadlines
from lfield.vm.engine_interface import Trap
from lfield.vm.host_interface import Sequencer
from lfield.vm.scheduler import Scheduler

Handler = Callable[[Agent, int, int, list[int]], None]


class SequencingHandlers:
    """The instructions, for the coordinators of one host (`own_host`, a number); `team` has all agents."""

    def __init__(
        self, scheduler: Scheduler, team: Sequence[TeamMember], own_host: int, limits: Deadlines
    ) -> None:
        self._scheduler, self._own_host, self._deadlines = scheduler, own_host, limits
        self._startable = {member.id: member for member in team if member.is_startable}

    def handlers(self) -> Mapping[str, Handler]:
        """The handlers, by name."""
        return {
            "seq_start": self._visiting(
                lambda agent, member, words: self._home.start(agent, member, words[1]), acts=True
            ),
            "seq_stop": self._visiting(
                lambda agent, member, words: self._home.stop(agent, member), acts=True
            ),
            "seq_end": self._visiting(lambda agent, member, words: self._home.end_of(agent, member)),
            "seq_alive": self._visiting(lambda agent, member, words: self._home.is_running(agent, member)),
        }

    @property
    def _home(self) -> Sequencer:
        return self._scheduler.world.sequencer

    def _visiting(
        self, ask: Callable[[Agent, TeamMember, list[int]], bool | str | None], *, acts: bool = False
    ) -> Handler:
        def on_request(agent: Agent, thread: int, operand: int, words: list[int]) -> None:
            scheduler = self._scheduler
            id = agent.block.string(words[0])
            member = self._startable.get(id)
            if member is None:
                known = ", ".join(self._startable) or "none"
                message = f"the deployment has no startable coordinator '{id}' (startable: {known})"
                scheduler.throw_builtin(agent, thread, "UnknownResourceException", message, id)
                return
            scheduler.freeze(agent, thread)
            if member.host != self._own_host:
                self._deadlines.depart(agent, member)
                return
            if not scheduler.world.may_start_call(agent, acts):
                return
            try:
                answer = ask(agent, member, words)
            except Trap as trap:
                agent.resume()
                scheduler.throw_builtin(agent, thread, trap.kind, trap.message, id)
                return
            if answer is not None:
                agent.resume()
                agent.invalidate_image()
                self._complete(agent, thread, answer)

        return on_request

    def _complete(self, agent: Agent, thread: int, answer: bool | str) -> None:
        if isinstance(answer, str):
            self._scheduler.complete(agent, thread, lambda: agent.block.new_string(answer))
        else:
            self._scheduler.complete_at_once(agent, thread, int(answer))
