"""A desk that pushes bundles to simulated robots with the code of `lfield push`, and sends commands."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

from lfield.errors import LfieldError
from lfield.event_loop import spawn
from lfield.net.tcp_transport import TcpTransport
from lfield.operator.fleet.activation import BallotResult, activate, new_ballot
from lfield.operator.fleet.bundle_upload import Upload, upload
from lfield.operator.fleet.service_link import ServiceLinks
from lfield.service.service_process import MAX_BLOCK
from lfield.simulate.computers.simulated_computer import SimulatedComputer
from lfield.simulate.host_fleet import host_at_address
from lfield.wire.service_messages import CommandResult, MissionCommand
from simulation_testing.services.service_disk import kill_here
from simulation_testing.services.service_fleet import ServiceFleet, bundle_version

#: The steps of a desk: a push, with or without robots that do not answer; commands to all robots.
DeskAction = Literal["push", "push without", "start", "stop", "discard"]
#: Seconds without a stored piece after which an upload fails, for the answer to a command, and for a whole
#: command.
TIMEOUT, ANSWER, COMMAND = 8.0, 20.0, 30.0


@cache
def _upload_of(robots: int, version: int) -> Upload:
    return Upload.of(bundle_version(robots, version))


@dataclass(frozen=True, slots=True)
class DeskStep:
    """One step of a desk: its time, its kind, and the version of the bundle.

    The desk is killed after a number of answers to a ballot, 0 for never.
    """

    at: float
    action: DeskAction
    version: int = 0
    dies_after: int = 0


class SimulatedDesk:
    """One computer with a desk. Its steps run one after another, each in a process of its own."""

    def __init__(self, fleet: ServiceFleet, name: str, steps: Sequence[DeskStep], rng: random.Random) -> None:
        self.name, self._fleet, self._rng = name, fleet, rng
        machine = fleet.new_machine(name, rng)
        fleet.network.join(machine)
        self._computer = SimulatedComputer(machine, fleet.network, {})
        fleet.stations.append(self._computer)
        self._process = self._computer.start()
        #: The results of its ballots.
        self.results: list[BallotResult] = []
        for step in steps:
            fleet.timeline.at(step.at, lambda step=step: self.perform(step))  # type: ignore[misc]

    def kill(self) -> None:
        """Kill the current step."""
        self._process.die(-9)

    def perform(self, step: DeskStep) -> None:
        """Start one step in parallel to unfinished ones."""
        if self._process.loop.dead:
            self._process = self._computer.start()
        self._fleet.note(self.name, f"{step.action} {step.version}")
        self._process.loop.enter(lambda: spawn(self._perform(step)))

    async def _perform(self, step: DeskStep) -> None:
        if step.action.startswith("push"):
            await self._push(step)
        else:
            command = MissionCommand(
                "start" if step.action == "start" else "stop", discards=step.action == "discard"
            )
            await self._command(command, self._fleet.robots)

    async def _push(self, step: DeskStep) -> None:
        """Push like `lfield push`."""
        robots, links = self._fleet.robots, self._links()
        what = _upload_of(len(robots), step.version)
        reached = await asyncio.gather(*(self._upload(links, robot, what) for robot in robots))
        hosts = [robot for robot, stored in zip(robots, reached, strict=True) if stored]
        without = [robot for robot in robots if robot not in hosts]
        if not hosts or (without and step.action == "push"):
            return
        process, answers = self._process, 0

        def on_change(result: BallotResult) -> None:
            nonlocal answers
            answers += 1
            if answers == step.dies_after:
                kill_here(process)

        ballot = new_ballot(what.digest, hosts, self.name, self._rng.randbytes)
        result = await activate(links, ballot, on_change)
        links.close()
        self._fleet.note(self.name, f"{ballot.id.hex()[:6]} {result.outcome} {result.votes} {result.reasons}")
        self.results.append(result)
        if result.outcome == "activated" and self._rng.random() < 0.5:
            await self._command(MissionCommand("start", what.digest, without=without), hosts)

    async def _upload(self, links: ServiceLinks, robot: str, what: Upload) -> bool:
        try:
            progress = await upload(links, robot, what, patience=TIMEOUT)
        except LfieldError:
            return False
        return not progress.refusal

    async def _command(self, command: MissionCommand, robots: Sequence[str]) -> None:
        await asyncio.gather(*(self._send_command(command, robot) for robot in robots))

    async def _send_command(self, command: MissionCommand, robot: str) -> None:
        """Send a command, again after broken links."""
        links = self._links()
        try:
            result = await links.ask(robot, command, CommandResult, COMMAND, ANSWER)
            self._fleet.note(self.name, f"{command.action} {robot}: {result.trouble or 'done'}")
        except LfieldError:
            self._fleet.note(self.name, f"{command.action} {robot}: no answer")
        finally:
            links.close()

    def _links(self) -> ServiceLinks:
        transport = TcpTransport(MAX_BLOCK, identify=host_at_address, busy=float)
        return ServiceLinks(transport, self._fleet.addresses)
