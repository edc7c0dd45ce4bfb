"""Doubles: resources whose portals answer from Python, in the test of a mission."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol
from unittest.mock import NonCallableMock

from lfield.bytecode.disassemble import type_name
from lfield.bytecode.program import MethodRecord, Program
from lfield.errors import DoubleError
from lfield.mission.mission import Mission
from lfield.simulate.fleet import Life
from lfield.testing.mission.answers import After, Throws
from lfield.testing.mission.calls import arguments_of
from lfield.testing.mission.values import Made, Mismatch, type_word
from lfield.text.suggest import did_you_mean, listed
from lfield.vm.agent import Member
from lfield.vm.attached import Asked
from lfield.vm.machine import Machine


class Later(Protocol):
    """Lets something happen in one life of a host, after so many seconds of true time."""

    def __call__(self, seconds: float, event: Callable[[], None]) -> None:
        """Let it happen, and the host see it, unless this life is over by then."""

    @property
    def is_over(self) -> bool:
        """Whether this life is over: a double may end it itself, in the middle of what the host does."""


class Doubles:
    """Objects that answer for resources, by the ids of those: a method for each portal, or an attribute that
    can be called. It is given the arguments as Python values (`values`) and returns the result, or `After`;
    it may raise `Throws`.

    The resource of a double is open at once: its `init` does not run, and it has no devices. So its live
    attributes are not known; in all else it offers what its class does. Calls of a `synchronized` portal do
    not wait for one another: the double is asked at once, and may answer `After`.

    What goes wrong in a double is put into `trouble`, and the portal that was called never ends: whoever runs
    the team raises that after the event. Raises DoubleError for a double that does not fit the mission.
    """

    def __init__(self, mission: Mission, doubles: Mapping[str, object]) -> None:
        for id, double in doubles.items():
            _check(mission.program, _stood_for(mission, id), double)
        self._doubles = dict(doubles)
        #: The mission, in which those resources have no devices.
        self.mission = without_devices(mission, doubles)
        self.trouble: list[BaseException] = []

    def watch(self, machine: Machine, later: Later) -> None:
        """Let the doubles answer on a machine, which is that of one life of a host, before anything runs.

        `later` is as `later_in` makes it for that life.
        """
        for id, double in self._doubles.items():
            machine.attached.stand_ins[id] = partial(self._asked, machine, later, double)

    def _asked(self, machine: Machine, later: Later, double: object, asked: Asked) -> None:
        """A portal is called. No exception of the double may come to L: it is one of the test."""
        if later.is_over:
            return
        try:
            answer = _answered(machine, double, asked)
            if not later.is_over:
                self._answer(machine, later, asked, answer)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            self.trouble.append(error)

    def _answer(self, machine: Machine, later: Later, asked: Asked, answer: object) -> None:
        wait = answer if isinstance(answer, After) else None
        value = wait.value if wait is not None else answer
        if isinstance(value, Throws):
            end = partial(asked.throw, value.kind, value.message)
        else:
            end = partial(asked.give, _made(machine, asked, value).put)
        if wait is None:
            end()
        else:
            later(wait.seconds, end)


def later_in(life: Life) -> Later:
    """Lets things happen in one life of a host of a simulated team; what is due after that does not."""
    return _InLife(life)


@dataclass(frozen=True, slots=True)
class _InLife:
    life: Life

    def __call__(self, seconds: float, event: Callable[[], None]) -> None:
        def happen() -> None:
            event()
            self.life.host.turn()

        self.life.process.loop.soon(happen, seconds)

    @property
    def is_over(self) -> bool:
        return self.life.process.loop.dead


def without_devices(mission: Mission, ids: Mapping[str, object]) -> Mission:
    """The same mission in which these agents have no devices."""
    devices = {agent: {} if agent in ids else fields for agent, fields in mission.bindings.devices.items()}
    return mission.with_bindings(replace(mission.bindings, devices=devices))


# --- when a portal is called --------------------------------------------------------------------------


def _answered(machine: Machine, double: object, asked: Asked) -> object:
    """What a double answers to a call. Raises DoubleError when it has no method for the portal."""
    portal = machine.program.core.methods[asked.method]
    method = getattr(double, portal.name, None)
    if not callable(method):
        raise DoubleError(
            f"the mission calls {asked.resource.id}.{_signature(machine.program, portal)}, and the double of "
            f"{asked.resource.id} has no method {portal.name}: add one"
        )
    try:
        return method(*arguments_of(machine, asked.resource, asked.thread, asked.method))
    except Throws as thrown:
        return thrown


def _made(machine: Machine, asked: Asked, value: object) -> Made:
    portal = machine.program.core.methods[asked.method]
    try:
        return Made(machine.program, portal.result, value)
    except Mismatch as mismatch:
        wanted = type_word(machine.program, portal.result)
        within = "" if mismatch.wanted == wanted else f", and in it {mismatch.wanted}"
        raise DoubleError(
            f"the portal {asked.resource.id}.{_signature(machine.program, portal)} gives {wanted}{within}, "
            f"and its double has returned {mismatch.came}: return a value of that type"
        ) from None


def _signature(program: Program, portal: MethodRecord) -> str:
    kinds = portal.slots[1 : 1 + portal.parameters]
    return f"{portal.name}({', '.join(type_name(program, kind) for kind in kinds)})"


# --- when the team is made ----------------------------------------------------------------------------


def _stood_for(mission: Mission, id: str) -> Member:
    """The resource that a double stands for. Raises DoubleError when there is none."""
    resources = [member for member in mission.team.members if member.kind == "resource"]
    found = next((member for member in mission.team.members if member.id == id), None)
    if found is None:
        ids = [member.id for member in resources]
        hint = did_you_mean(id, ids) or f"it has {listed(ids)}"
        raise DoubleError(f"a double stands for '{id}', and the deployment has no such resource: {hint}")
    if found.kind != "resource":
        raise DoubleError(
            f"a double stands for '{id}', which is a coordinator and has no portals: give doubles to the "
            f"resources that it calls"
        )
    return found


def _check(program: Program, member: Member, double: object) -> None:
    """Raises DoubleError when an object cannot be the double of a resource."""
    portals = _portals(program, member.type)
    if isinstance(double, type):
        raise DoubleError(
            f"the double of {member.id} is the class {double.__name__}: give an object of it, "
            f"{double.__name__}()"
        )
    for name, method in _methods(double):
        if name not in portals:
            hint = did_you_mean(name, portals) or f"its portals are {listed(portals)}"
            raise DoubleError(
                f"the double of {member.id} has a method {name}, and {member.type} has no such portal: "
                f"{hint}; what is for the double alone begins with an underscore"
            )
        for portal in portals[name]:
            if not _takes(method, portal.parameters):
                count = f"{portal.parameters} argument{'' if portal.parameters == 1 else 's'}"
                raise DoubleError(
                    f"the method {name} of the double of {member.id} cannot take the {count} of the portal "
                    f"{_signature(program, portal)}: give it as many parameters"
                )


def _portals(program: Program, type: str) -> dict[str, list[MethodRecord]]:
    """The portals of a resource by name; one that is overloaded has several."""
    owner, found = program.class_index[type], dict[str, list[MethodRecord]]()
    for method in program.core.methods:
        if method.owner == owner and method.kind == "portal":
            found.setdefault(method.name, []).append(method)
    return found


def _methods(double: object) -> Iterator[tuple[str, Callable[..., object]]]:
    """What of an object can be called, and is not its own affair; no property is asked.

    A mock has methods for the test, beside those that it stands for.
    """
    own = dir(NonCallableMock) if isinstance(double, NonCallableMock) else ()
    for name in dir(double):
        if (
            name.startswith("_")
            or name in own
            or isinstance(inspect.getattr_static(double, name, None), property)
        ):
            continue
        value = getattr(double, name)
        if callable(value) and not isinstance(value, type):
            yield name, value


def _takes(method: Callable[..., object], count: int) -> bool:
    """Whether a method can be called with so many arguments; of one that does not tell, it can."""
    try:
        signature = inspect.signature(method)
    except ValueError:
        return True
    try:
        signature.bind(*[None] * count)
    except TypeError:
        return False
    return True
