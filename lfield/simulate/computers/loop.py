"""The loop of a process of a simulated machine: its time is the machine's, and it can be stopped and killed.

Everything that comes from outside (bytes, the end of a link, the answer of a disk) goes through `enter`. What
is under way in a process that is frozen, as by SIGSTOP, waits; of one that is dead it is gone.
"""

from __future__ import annotations

import asyncio
import ctypes
import errno
import math
import sys
import threading
import warnings
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn
from weakref import WeakValueDictionary

from lfield.loop import abandon
from lfield.simulate.computers.machines import Machine
from lfield.simulate.computers.timeline import Planned

#: So many rounds of a loop take no time; then the others have their turn, as many seconds later as they took.
ROUNDS, TOOK = 100, 0.001
#: No timer is exacter: who looks too early by less than a clock can tell would look for ever.
TICK = 1e-9
#: Seconds that work in a thread takes.
IN_A_THREAD = 0.002
#: Seconds of computing that others wait for; less is owed until it has come to that.
GRAIN = 0.001
#: So many `finally` blocks of one coroutine may await something while it is closed.
UNWINDS = 10


#: One reference more, or less, than anybody holds. What is pinned no collector frees, also not at the end.
_pin, _unpin = ctypes.pythonapi.Py_IncRef, ctypes.pythonapi.Py_DecRef
_pin.argtypes = _unpin.argtypes = (ctypes.py_object,)
_pin.restype = _unpin.restype = None


def beyond(deed: str) -> NoReturn:
    """A process wants to do what leads out of the simulation; who fences that in is told first (PEP 578)."""
    sys.audit("lfield.beyond", deed)
    raise OSError(errno.ENETUNREACH, f"it wanted to {deed}, and nothing simulated leads there")


#: Whose the asynchronous generators are that have begun and not ended, by their ids.
_owners: WeakValueDictionary[int, ProcessLoop] = WeakValueDictionary()


@contextmanager
def generators() -> Iterator[None]:
    """Within, an asynchronous generator that nobody has any more is closed by its process.

    By asyncio's way each loop tells Python, whenever it begins and ends to run, which is at every event, and
    Python tells whoever audits it.
    """
    before = sys.get_asyncgen_hooks()
    sys.set_asyncgen_hooks(_begins, _is_left)
    try:
        yield
    finally:
        sys.set_asyncgen_hooks(*before)


def _begins(generator: AsyncGenerator[Any, Any]) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, ProcessLoop), "no other runs within"
    _owners[id(generator)] = loop


def _is_left(generator: AsyncGenerator[Any, Any]) -> None:
    if (loop := _owners.pop(id(generator), None)) is not None:
        loop.call_soon(loop.create_task, generator.aclose())


class _Nothing:
    """Stands where a loop has its selector: nothing is ever ready, and where it would wait it is over."""

    def __init__(self, loop: ProcessLoop) -> None:
        self._loop = loop

    def select(self, timeout: float | None) -> Sequence[object]:
        self._loop.would_wait(timeout)
        return ()


class ProcessLoop(asyncio.BaseEventLoop):
    """The loop of a process. It runs while the timeline is at one moment, and never waits."""

    # What `run_forever` of asyncio goes by, from 3.11 on.
    _stopping: bool
    _thread_id: int | None
    _check_running: Callable[[], None]
    _run_once: Callable[[], None]

    def __init__(self, machine: Machine) -> None:
        super().__init__()
        self._selector = _Nothing(self)
        self.machine, self._timeline, self.clock = machine, machine.timeline, machine.clock
        self.frozen = self.dead = False
        self._backlog: list[Callable[[], object]] = []
        self._wake: Planned | None = None
        self._woken_at = math.inf
        self._rounds = 0
        #: Seconds that were computed and that nobody has waited for yet.
        self._owed = 0.0
        #: For how long nothing happens from now on, and whether it is so now.
        self._hold: float | None = None
        self._held = False
        self.set_task_factory(_pinned)  # type: ignore[arg-type]

    def time(self) -> float:
        """Its machine's clock for timers."""
        return self.clock.awake()

    def __del__(self) -> None:
        """It holds nothing of the real computer: nobody need close it."""

    # --- from outside ---------------------------------------------------------------------------------

    def enter(self, event: Callable[[], object]) -> None:
        """Something comes in: let the loop run, if the process can."""
        if self.dead:
            return
        if self.frozen or self._held:
            self._backlog.append(event)
            return
        self.call_soon(event)
        self._run()

    def soon(self, event: Callable[[], object], seconds: float = 0.0) -> None:
        """Let something come in, later on."""
        self._timeline.after(seconds, lambda: self.enter(event))

    def freeze(self) -> None:
        """As SIGSTOP."""
        self.frozen = True

    def thaw(self) -> None:
        """As SIGCONT: what has come meanwhile, and the timers that are over, all at once."""
        if self.frozen and not self.dead:
            self.frozen = False
            self._catch_up()

    def die(self) -> None:
        """As SIGKILL: none of its coroutines goes on, and none is unwound (`_pinned`)."""
        self.dead = True
        self._backlog.clear()
        if self._wake is not None:
            self._wake.call_off()

    def compute(self, seconds: float) -> None:
        """What is done now takes so long on this computer: meanwhile nothing else of the process happens."""
        self._owed += seconds
        if self._owed >= GRAIN:
            self.hold(self._owed)
            self._owed = 0.0

    def hold(self, seconds: float = 0.0) -> None:
        """When what is done now is done, nothing of the process happens for so long."""
        self._hold = (self._hold or 0.0) + seconds
        self.stop()

    # --- the loop -------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._rounds = 0
        self._until_stopped()
        if self._hold is not None:
            self._held = True
            self._timeline.after(self._hold, self._let_go)
            self._hold = None

    def _until_stopped(self) -> None:
        """As `run_forever`, but that generators are seen to for all loops at once: see `generators`."""
        self._check_running()
        self._thread_id = threading.get_ident()
        asyncio._set_running_loop(self)
        try:
            while not self._stopping:
                self._run_once()
        finally:
            self._stopping, self._thread_id = False, None
            asyncio._set_running_loop(None)

    def _let_go(self) -> None:
        self._held = False
        if not self.dead and not self.frozen:
            self._catch_up()

    def _catch_up(self) -> None:
        if self._held:
            return
        for event in self._backlog:
            self.call_soon(event)
        self._backlog.clear()
        self._run()

    def would_wait(self, timeout: float | None) -> None:
        """There is nothing more to do for so many seconds of its clock, None for ever."""
        self._rounds += 1
        if timeout == 0 and self._rounds < ROUNDS:
            return
        self.stop()
        if timeout is not None:
            due = self.clock.true(self.time() + (timeout or TOOK))
            self._wake_at(max(due, self._timeline.now + TICK))

    def _wake_at(self, when: float) -> None:
        if self._wake is not None:
            if self._woken_at <= when and self._wake.event is not None:
                return
            self._wake.call_off()
        self._woken_at = when
        self._wake = self._timeline.at(when, self._on_wake)

    def _on_wake(self) -> None:
        self._wake = None
        self._woken_at = math.inf
        if self.dead:
            return
        if self.frozen or self._held:
            self._backlog.append(_nothing)
            return
        self._run()

    def _process_events(self, events: object) -> None:
        """Nothing comes in by itself."""

    def _write_to_self(self) -> None:
        """There are no threads."""

    def run_in_executor(self, _: object, func: Callable[..., Any], *args: Any) -> Any:  # type: ignore[override]
        """What others do in a thread, a disk for the most part: it takes its time, and others go on."""
        future = self.create_future()

        def done() -> None:
            if future.done():
                return
            try:
                future.set_result(func(*args))
            except Exception as error:
                future.set_exception(error)

        self.soon(done, IN_A_THREAD)
        return future


def _pinned(
    loop: asyncio.AbstractEventLoop, coro: Coroutine[Any, Any, Any], **more: Any
) -> asyncio.Task[Any]:
    """A task that stays where it is until it has ended by itself, or until `release`.

    A coroutine that is freed is unwound: its `finally` blocks run. SIGKILL does nothing of the kind, so the
    tasks of a dead process must not be freed while the simulation runs.
    """
    assert isinstance(loop, ProcessLoop)
    pinned = loop.machine.pinned
    task: asyncio.Task[Any] = asyncio.Task(coro, loop=loop, **more)
    pinned.add(task)
    _pin(task)

    def unpin(task: asyncio.Task[Any]) -> None:
        if task in pinned:
            pinned.discard(task)
            _unpin(task)

    task.add_done_callback(unpin)
    return task


def release(machine: Machine) -> None:
    """Free the tasks that its processes have left, once nothing runs on it any more.

    The simulation is over: what their `finally` blocks do now is seen by nobody, and what they raise is
    dropped.
    """
    with warnings.catch_warnings():
        # A `finally` block may begin a coroutine that nobody awaits.
        warnings.simplefilter("ignore")
        while machine.pinned:
            task = machine.pinned.pop()
            # asyncio would report a task that is freed before it has ended.
            task.get_loop().set_exception_handler(lambda loop, context: None)
            _unwind(task.get_coro())
            abandon(task)
            _unpin(task)


def _unwind(coroutine: Any) -> None:
    """Close a coroutine. One that awaits in a `finally` block is closed there as well."""
    for _ in range(UNWINDS):
        try:
            coroutine.close()
        except Exception:
            continue
        return


def _nothing() -> None:
    pass
