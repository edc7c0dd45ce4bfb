"""Doubles: resources whose portals are implemented in Python, for tests of missions."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from unittest.mock import NonCallableMock

from lfield.bytecode.disassembler import type_name
from lfield.bytecode.program import MethodRecord, Program
from lfield.errors import DoubleError
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import HostRun
from lfield.testing.mission import live_attributes
from lfield.testing.mission.call_record import arguments_of
from lfield.testing.mission.double_answers import After, Throws
from lfield.text.suggestions import did_you_mean, listed
from lfield.vm.agent import TeamMember
from lfield.vm.hooks import StubCall
from lfield.vm.machine import Machine
from lfield.vm.memory.threads import place_of
from lfield.vm.person_calls.value_conversion import EncodedValue, Mismatch, type_text


class ResourceDoubles:
    """Objects that replace resources, by resource id: a method, or a callable attribute, for each portal. It
    gets the arguments as Python values (`value_conversion`) and returns the result or `After`; it may raise
    `Throws`. The mission was loaded with them `doubled`.

    The resource of a double is open immediately, without `init` and devices. Its live attributes are from the
    double (`live_attributes`); its other offers are those of its class. `synchronized` portals are called one
    at a time, in order; the owner calls `release_monitors` after each event.

    A failure of a double goes to `failures`, and its portal never ends: the owner raises it after the event.
    Raises DoubleError for a double that does not fit the mission.
    """

    def __init__(self, mission: Mission, doubles: Mapping[str, object]) -> None:
        self._mission = mission
        self._doubles: list[tuple[TeamMember, object]] = []
        for id, double in doubles.items():
            member = _stood_for(mission, id)
            _check(mission.program, member, double)
            live_attributes.check(mission, member, double)
            self._doubles.append((member, double))
        self.failures: list[BaseException] = []
        self._monitors: list[_Monitor] = []

    def attach(self, run: HostRun) -> None:
        """Connects the doubles to one incarnation of a host, before any agent runs."""
        machine, later = run.core.machine, _Later(run)
        for member, double in self._doubles:
            monitor = _Monitor(machine, later, partial(self._answer, machine, later, double))
            machine.hooks.stubs[member.id] = monitor.on_call
            self._monitors.append(monitor)
            if live_attributes.has_live_attributes(double):
                live_attributes.attach(self._mission, member, run, double, self.failures)

    def release_monitors(self) -> None:
        """Called after each event: starts the next calls of synchronized portals that are free."""
        for monitor in self._monitors:
            monitor.release()

    def _answer(self, machine: Machine, later: _Later, double: object, call: StubCall) -> None:
        """Handles a portal call. Exceptions of the double are the test's, not L's."""
        if later.is_over:
            return
        try:
            answer = _answered(machine, double, call)
            if not later.is_over:
                self._end(machine, later, call, answer)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            self.failures.append(error)

    def _end(self, machine: Machine, later: _Later, call: StubCall, answer: object) -> None:
        wait = answer if isinstance(answer, After) else None
        value = wait.value if wait is not None else answer
        if isinstance(value, Throws):
            end = partial(call.throw, value.kind, value.message)
        else:
            end = partial(call.return_result, _encoded(machine, call, value).put)
        if wait is None:
            end()
        else:
            later(wait.seconds, end)


@dataclass(frozen=True, slots=True)
class _Later:
    """Schedules events in one incarnation of a host, in seconds of true time."""

    run: HostRun

    def __call__(self, seconds: float, event: Callable[[], None]) -> None:
        def happen() -> None:
            event()
            self.run.host.step()

        self.run.process.loop.soon(happen, seconds)

    @property
    def is_over(self) -> bool:
        """Whether the incarnation has ended, perhaps by the double itself."""
        return self.run.process.loop.dead


@dataclass(slots=True)
class _Monitor:
    """Calls a double in one incarnation of its host: synchronized portals one at a time, in order."""

    _machine: Machine
    _later: _Later
    _answer: Callable[[StubCall], None]
    _current: StubCall | None = None
    _waiting: deque[StubCall] = field(default_factory=deque)

    def on_call(self, call: StubCall) -> None:
        """Handles a call of a portal."""
        if not self._machine.program.core.methods[call.method].synchronized:
            self._answer(call)
            return
        self._waiting.append(call)
        self.release()

    def release(self) -> None:
        """Starts the next call when the present one has ended or was cancelled."""
        if not self._waiting or (self._current is not None and _is_pending(self._current)):
            return
        self._current = self._waiting.popleft()
        self._later(0.0, partial(self._start, self._current))

    def _start(self, call: StubCall) -> None:
        if _is_pending(call):
            self._answer(call)


def _is_pending(call: StubCall) -> bool:
    """Whether a call is neither cancelled nor answered."""
    return not call.resource.ended and bool(place_of(call.resource.block, call.thread))


# --- when a portal is called --------------------------------------------------------------------------


def _answered(machine: Machine, double: object, call: StubCall) -> object:
    """The answer of a double. Raises DoubleError when it has no method for the portal."""
    portal = machine.program.core.methods[call.method]
    method = getattr(double, portal.name, None)
    if not callable(method):
        raise DoubleError(
            f"the mission calls {call.resource.id}.{_signature(machine.program, portal)}, but the double of "
            f"{call.resource.id} has no method {portal.name}: add one"
        )
    try:
        return method(*arguments_of(machine, call.resource, call.thread, call.method))
    except Throws as thrown:
        return thrown


def _encoded(machine: Machine, call: StubCall, value: object) -> EncodedValue:
    portal = machine.program.core.methods[call.method]
    try:
        return EncodedValue(machine.program, portal.result, value)
    except Mismatch as mismatch:
        expected = type_text(machine.program, portal.result)
        within = "" if mismatch.expected == expected else f", and in it {mismatch.expected}"
        raise DoubleError(
            f"the portal {call.resource.id}.{_signature(machine.program, portal)} returns {expected}{within}"
            f", but its double has returned {mismatch.problem}: return a value of that type"
        ) from None


def _signature(program: Program, portal: MethodRecord) -> str:
    kinds = portal.slots[1 : 1 + portal.parameters]
    return f"{portal.name}({', '.join(type_name(program, kind) for kind in kinds)})"


# -- when the team is created --------------------------------------------------------------------------


def _stood_for(mission: Mission, id: str) -> TeamMember:
    """The resource that a double replaces. Raises DoubleError when there is none."""
    resources = [member for member in mission.team.members if member.kind == "resource"]
    found = next((member for member in mission.team.members if member.id == id), None)
    if found is None:
        ids = [member.id for member in resources]
        hint = did_you_mean(id, ids) or f"it has {listed(ids)}"
        raise DoubleError(f"there is a double of '{id}', but the deployment has no such resource: {hint}")
    if found.kind != "resource":
        raise DoubleError(
            f"'{id}' is a coordinator, which has no portals: give doubles to the resources that it calls"
        )
    return found


def _check(program: Program, member: TeamMember, double: object) -> None:
    """Raises DoubleError when an object cannot be the double of a resource."""
    portals = _portals(program, member.type)
    if isinstance(double, type):
        raise DoubleError(
            f"the double of {member.id} is the class {double.__name__}: give an instance, {double.__name__}()"
        )
    for name, method in _methods(double):
        if name not in portals:
            hint = did_you_mean(name, portals) or f"its portals are {listed(portals)}"
            raise DoubleError(
                f"the double of {member.id} has a method {name}, but {member.type} has no such portal: "
                f"{hint}; start the names of its own methods with an underscore"
            )
        for portal in portals[name]:
            if not _accepts(method, portal.parameters):
                count = f"{portal.parameters} argument{'' if portal.parameters == 1 else 's'}"
                raise DoubleError(
                    f"the method {name} of the double of {member.id} cannot take the {count} of the portal "
                    f"{_signature(program, portal)}: give it as many parameters"
                )


def _portals(program: Program, type: str) -> dict[str, list[MethodRecord]]:
    """The portals of a resource by name; an overloaded name has several."""
    owner, found = program.class_index[type], dict[str, list[MethodRecord]]()
    for method in program.core.methods:
        if method.owner == owner and method.kind == "portal":
            found.setdefault(method.name, []).append(method)
    return found


def _methods(double: object) -> Iterator[tuple[str, Callable[..., object]]]:
    """The public callables of an object; properties are not evaluated.

    Methods that a mock has for the test are excluded.
    """
    own = {live_attributes.NAME, *(dir(NonCallableMock) if isinstance(double, NonCallableMock) else ())}
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


def _accepts(method: Callable[..., object], count: int) -> bool:
    """Whether a method accepts so many arguments; True if that is unknown."""
    try:
        signature = inspect.signature(method)
    except ValueError:
        return True
    try:
        signature.bind(*[None] * count)
    except TypeError:
        return False
    return True
