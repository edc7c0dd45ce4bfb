"""Doubles: resources whose portals answer from Python, in the test of a mission."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from unittest.mock import NonCallableMock

from lfield.bytecode.disassemble import type_name
from lfield.bytecode.program import MethodRecord, Program
from lfield.errors import DoubleError
from lfield.mission.mission import Mission
from lfield.simulate.fleet import Life
from lfield.testing.mission import stated
from lfield.testing.mission.answers import After, Throws
from lfield.testing.mission.calls import arguments_of
from lfield.testing.mission.values import Made, Mismatch, type_word
from lfield.text.suggest import did_you_mean, listed
from lfield.vm.agent import Member
from lfield.vm.attached import Asked
from lfield.vm.machine import Machine
from lfield.vm.memory.threads import place_of


class Doubles:
    """Objects that answer for resources, by the ids of those: a method for each portal, or an attribute that
    can be called. It is given the arguments as Python values (`values`) and returns the result, or `After`;
    it may raise `Throws`. The mission was loaded with them `doubled`.

    The resource of a double is open at once: its `init` does not run, and it has no devices. Its live
    attributes are what the double says of them (`stated`); in all else it offers what its class does.
    `synchronized` portals are asked one at a time, as they were called: whoever runs the team lets them
    `take_turns` after each event.

    What goes wrong in a double is put into `trouble`, and the portal that was called never ends: whoever runs
    the team raises that after the event. Raises DoubleError for a double that does not fit the mission.
    """

    def __init__(self, mission: Mission, doubles: Mapping[str, object]) -> None:
        self._mission = mission
        self._doubles: list[tuple[Member, object]] = []
        for id, double in doubles.items():
            member = _stood_for(mission, id)
            _check(mission.program, member, double)
            stated.check(mission, member, double)
            self._doubles.append((member, double))
        self.trouble: list[BaseException] = []
        self._monitors: list[_Monitor] = []

    def watch(self, life: Life) -> None:
        """Let the doubles answer in one life of a host, before anything runs."""
        machine, later = life.core.machine, _Later(life)
        for member, double in self._doubles:
            monitor = _Monitor(machine, later, partial(self._answer, machine, later, double))
            machine.attached.stand_ins[member.id] = monitor.asked
            self._monitors.append(monitor)
            if stated.tells(double):
                stated.attach(self._mission, member, life, double, self.trouble)

    def take_turns(self) -> None:
        """Something has happened: where nobody is in a synchronized portal any more, the next one is."""
        for monitor in self._monitors:
            monitor.look()

    def _answer(self, machine: Machine, later: _Later, double: object, asked: Asked) -> None:
        """A portal is called. No exception of the double may come to L: it is one of the test."""
        if later.is_over:
            return
        try:
            answer = _answered(machine, double, asked)
            if not later.is_over:
                self._end(machine, later, asked, answer)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            self.trouble.append(error)

    def _end(self, machine: Machine, later: _Later, asked: Asked, answer: object) -> None:
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


@dataclass(frozen=True, slots=True)
class _Later:
    """Lets something happen in one life of a host after so many seconds of true time, and the host see it."""

    life: Life

    def __call__(self, seconds: float, event: Callable[[], None]) -> None:
        def happen() -> None:
            event()
            self.life.host.turn()

        self.life.process.loop.soon(happen, seconds)

    @property
    def is_over(self) -> bool:
        """Whether this life is: a double may end it itself, in the middle of what the host does."""
        return self.life.process.loop.dead


@dataclass(slots=True)
class _Monitor:
    """Asks a double in one life of its host: of synchronized portals one at a time, in the order of calls."""

    _machine: Machine
    _later: _Later
    _answer: Callable[[Asked], None]
    _inside: Asked | None = None
    _waiting: deque[Asked] = field(default_factory=deque)

    def asked(self, asked: Asked) -> None:
        """A portal is called."""
        if not self._machine.program.core.methods[asked.method].synchronized:
            self._answer(asked)
            return
        self._waiting.append(asked)
        self.look()

    def look(self) -> None:
        """Let the next one in, when whoever was inside has left or was cancelled."""
        if not self._waiting or (self._inside is not None and _goes_on(self._inside)):
            return
        self._inside = self._waiting.popleft()
        self._later(0.0, partial(self._enter, self._inside))

    def _enter(self, asked: Asked) -> None:
        if _goes_on(asked):
            self._answer(asked)


def _goes_on(asked: Asked) -> bool:
    """Whether a call was not cancelled, and has no answer yet."""
    return not asked.resource.ended and bool(place_of(asked.resource.block, asked.thread))


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
    own = {stated.NAME, *(dir(NonCallableMock) if isinstance(double, NonCallableMock) else ())}
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
