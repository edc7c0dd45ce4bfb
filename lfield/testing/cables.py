"""A fake on virtual time, at the far end of a cable: a process of a machine of its own.

It goes on whatever becomes of the computer at the near end, as hardware does.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from lfield.driver.sims import Sim, SimOnLoop
from lfield.errors import LfieldError, MissionTestError, PluginError
from lfield.loop import Fake
from lfield.simulate.computers.computer import Computer
from lfield.simulate.computers.loop import generators
from lfield.simulate.computers.machines import Machine
from lfield.simulate.computers.network import Network
from lfield.simulate.computers.timeline import Timeline

#: Seconds for all fakes to be ready, and how often to look.
READY, LOOK = 5.0, 0.01


class CabledFake:
    """A fake with options of `lfield sim`. Raises PluginError, MissionTestError for options it has not."""

    def __init__(
        self, name: str, sim: Sim, options: Sequence[str], timeline: Timeline, network: Network
    ) -> None:
        if not isinstance(sim, SimOnLoop):
            raise PluginError(f"the fake '{sim.name}' cannot run on virtual time: it has no `serve`")
        parser = _Parser(prog=f"the fake '{sim.name}'", add_help=False)
        sim.add_arguments(parser)
        args = parser.parse_args(options)
        self.name = name
        #: What it serves, once it does; why it cannot, in a sentence.
        self.serving: Fake | None = None
        self.problem = ""
        #: What it has raised that it should not.
        self.trouble: list[MissionTestError] = []
        # The hardware's dice come from its name: one device more changes nothing for the others.
        machine = Machine(name, timeline, random.Random(name))
        network.plug_in(machine)
        self.process = Computer(machine, network, {}).start()
        self.process.on_fake = self._serves
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
        except Exception as error:  # a fake is foreign code: whoever runs the test is told
            self._has_failed(error)

    def _serves(self, fake: Fake) -> None:
        self.serving = fake

    def _raised(self, _: object, context: dict[str, Any]) -> None:
        self._has_failed(context.get("exception") or RuntimeError(context["message"]))

    def _has_failed(self, cause: BaseException) -> None:
        trouble = MissionTestError(f"the fake of {self.name} has failed by {type(cause).__name__}: {cause}")
        trouble.__cause__ = cause
        self.trouble.append(trouble)


K = TypeVar("K")


def all_serve(fakes: Mapping[K, CabledFake], timeline: Timeline) -> dict[K, Fake]:
    """Let time go on until all of them serve. Raises MissionTestError, and what one raised."""
    end = timeline.now + READY
    while len(served := {key: fake.serving for key, fake in fakes.items() if fake.serving}) < len(fakes):
        for error in (error for fake in fakes.values() for error in fake.trouble):
            raise error
        if problems := [fake.problem for fake in fakes.values() if fake.problem]:
            raise MissionTestError("; ".join(problems))
        if timeline.now >= end:
            late = ", ".join(fake.name for fake in fakes.values() if fake.serving is None)
            raise MissionTestError(f"the fake of {late} was not ready within {READY:g} s")
        with generators():
            timeline.run(LOOK)
    return served


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are a test's, and end no process."""

    def error(self, message: str) -> None:  # type: ignore[override]
        raise MissionTestError(f"{self.prog}: {message}")
