"""A simulated device on virtual time at the far end of a cable: a process on its own machine.

Like hardware, the device is independent of the computer at the near end.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn, TypeVar

from lfield.driver.sims import Sim, SimOnLoop
from lfield.errors import LfieldError, MissionTestError, PluginError
from lfield.event_loop import ServedFake
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import closing_generators
from lfield.simulate.computers.simulated_computer import SimulatedComputer
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.computers.simulated_network import SimulatedNetwork

#: Seconds for all simulated devices to be ready, and between two checks.
READY, POLL_INTERVAL = 5.0, 0.01


class CabledFake:
    """A simulated device with options of `lfield sim`. Raises PluginError, or MissionTestError for unknown
    options."""

    def __init__(
        self, name: str, sim: Sim, options: Sequence[str], timeline: EventQueue, network: SimulatedNetwork
    ) -> None:
        if not isinstance(sim, SimOnLoop):
            raise PluginError(f"simulated device '{sim.name}' cannot run on virtual time: it has no `serve`")
        parser = _Parser(prog=f"the simulated device '{sim.name}'", add_help=False)
        sim.add_arguments(parser)
        args = parser.parse_args(options)
        self.name = name
        #: The served device, once it is ready; else the reason why it cannot be served, in a sentence.
        self.serving: ServedFake | None = None
        self.problem = ""
        #: Unexpected exceptions of the device.
        self.failures: list[MissionTestError] = []
        # The random numbers depend on the device's name, so that adding a device does not affect others.
        machine = SimulatedMachine(name, timeline, random.Random(name))
        network.plug_in(machine)
        self.computer = SimulatedComputer(machine, network, {})
        self.process = self.computer.start(on_fake=self._serves)
        loop = self.process.loop
        loop.set_exception_handler(self._raised)
        loop.enter(lambda: loop.create_task(self._serve(sim, args)))

    async def _serve(self, sim: SimOnLoop, args: argparse.Namespace) -> None:
        try:
            await sim.serve(args)
        except (LfieldError, ValueError) as error:
            if self.serving:
                self._has_failed(error)
            self.problem = f"{self.name}: {error}"
        except Exception as error:  # a simulated device is third-party code: report to the test
            self._has_failed(error)

    def _serves(self, fake: ServedFake) -> None:
        self.serving = fake

    def _raised(self, _: object, context: dict[str, Any]) -> None:
        self._has_failed(context.get("exception") or RuntimeError(context["message"]))

    def _has_failed(self, cause: BaseException) -> None:
        problem = f"the simulated device of {self.name} has failed: {type(cause).__name__}: {cause}"
        failure = MissionTestError(problem)
        failure.__cause__ = cause
        self.failures.append(failure)


K = TypeVar("K")


def wait_until_serving(fakes: Mapping[K, CabledFake], timeline: EventQueue) -> dict[K, ServedFake]:
    """Runs until all devices are served. Raises MissionTestError, and an exception of a device."""
    end = timeline.now + READY
    while len(served := {key: fake.serving for key, fake in fakes.items() if fake.serving}) < len(fakes):
        for error in (error for fake in fakes.values() for error in fake.failures):
            raise error
        if problems := [fake.problem for fake in fakes.values() if fake.problem]:
            raise MissionTestError("; ".join(problems))
        if timeline.now >= end:
            pending = ", ".join(fake.name for fake in fakes.values() if fake.serving is None)
            raise MissionTestError(f"the simulated device of {pending} was not ready within {READY:g} s")
        with closing_generators():
            timeline.run(POLL_INTERVAL)
    return served


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are exceptions of the test."""

    def error(self, message: str) -> NoReturn:
        raise MissionTestError(f"{self.prog}: {message}")
