"""The event loop of a simulated process: on its machine's time; can be stopped and killed.

External events (bytes, the end of a link, disk completions) go through `enter`. They wait while the process
is frozen (SIGSTOP), and are dropped when it is dead.
"""

from __future__ import annotations

import asyncio
import ctypes
import errno
import gc
import math
import sys
import threading
import warnings
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn
from weakref import WeakValueDictionary

from lfield.event_loop import abandon
from lfield.simulate.computers.event_queue import PlannedEvent
from lfield.simulate.computers.simulated_machine import SimulatedMachine

#: Rounds of a loop that take no time; then other processes run, for the time of the rounds.
ROUNDS, ROUND_TIME = 100, 0.001
#: Resolution of timers: a shorter wait might never end because of rounding.
TICK = 1e-9
#: Seconds of work in a thread.
THREAD_TIME = 0.002
#: Computing time in seconds from which others wait; less is accumulated.
TIMER_GRAIN = 0.001
#: `finally` blocks of one coroutine that may await while it is closed.
MAX_UNWINDS = 10


#: Add or remove a reference. A pinned object is never freed by a garbage collector.
_pin, _unpin = ctypes.pythonapi.Py_IncRef, ctypes.pythonapi.Py_DecRef
_pin.argtypes = _unpin.argtypes = (ctypes.py_object,)
_pin.restype = _unpin.restype = None


def unsupported(operation: str) -> NoReturn:
    """Refuses a call that would leave the simulation; audit hooks are notified first (PEP 578)."""
    sys.audit("lfield.beyond", operation)
    raise OSError(errno.ENETUNREACH, f"it tried to {operation}, which a simulation does not support")


#: New objects until a collection, and collections of each generation until one of the next.
COLLECTION_THRESHOLDS = (100_000, 20, 100)
#: Memory blocks, of 100 bytes on average, by which a process grows until closed simulations are freed.
MAX_GROWTH = 1_000_000
#: Owners of running asynchronous generators, by id.
_owners: WeakValueDictionary[int, ProcessLoop] = WeakValueDictionary()


@contextmanager
def closing_generators() -> Iterator[None]:
    """Within the block, an asynchronous generator without references is closed by its process.

    asyncio would register hooks with Python whenever a loop starts or stops, at every event, and each time
    with an audit event.
    """
    before = sys.get_asyncgen_hooks()
    sys.set_asyncgen_hooks(_on_generator_start, _on_generator_end)
    try:
        yield
    finally:
        sys.set_asyncgen_hooks(*before)


@contextmanager
def unscanned_heap() -> Iterator[None]:
    """Within the block, Python's garbage collector does not scan the objects that existed before.

    Nearly all objects of a large fleet live until its end, and each full collection would scan all hosts. New
    objects are scanned less often than usual, for the same reason.
    """
    thresholds = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(*COLLECTION_THRESHOLDS)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
        gc.unfreeze()


class _ClosedSimulations:
    """Frees the objects of closed simulations, which are cycles.

    `unscanned_heap` moves objects to the oldest generation, where Python does not count them, so that without
    these collections it would free none of them.
    """

    def __init__(self) -> None:
        self._blocks_left = sys.getallocatedblocks()

    def collect(self) -> None:
        """Run a full collection, if the process has grown enough since the last one."""
        if sys.getallocatedblocks() > self._blocks_left + MAX_GROWTH:
            gc.collect()
            self._blocks_left = sys.getallocatedblocks()


closed_simulations = _ClosedSimulations()


def _on_generator_start(generator: AsyncGenerator[Any, Any]) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, ProcessLoop), "no other runs within"
    _owners[id(generator)] = loop


def _on_generator_end(generator: AsyncGenerator[Any, Any]) -> None:
    if (loop := _owners.pop(id(generator), None)) is not None:
        loop.call_soon(loop.create_task, generator.aclose())


class _NoSelector:
    """Replaces a loop's selector: no file is ever ready, and waiting ends the run."""

    def __init__(self, loop: ProcessLoop) -> None:
        self._loop = loop

    def select(self, timeout: float | None) -> Sequence[object]:
        self._loop.would_wait(timeout)
        return ()


class ProcessLoop(asyncio.BaseEventLoop):
    """The loop of a process. It runs within one moment of true time, and never waits."""

    # Used by `run_forever` of asyncio from 3.11.
    _stopping: bool
    _thread_id: int | None
    _check_running: Callable[[], None]
    _run_once: Callable[[], None]

    def __init__(self, machine: SimulatedMachine) -> None:
        super().__init__()
        self._selector = _NoSelector(self)
        self.machine, self._timeline, self.clock = machine, machine.timeline, machine.clock
        self.frozen = self.dead = False
        self._backlog: list[Callable[[], object]] = []
        self._wake: PlannedEvent | None = None
        self._wake_time = math.inf
        self._rounds = 0
        #: Computing time that has not been waited for.
        self._charged_seconds = 0.0
        #: The seconds for which the process is held from now on, and whether it is held.
        self._hold: float | None = None
        self._held = False
        self.set_task_factory(_pinned)  # type: ignore[arg-type]  # typeshed demands a generic function

    def time(self) -> float:
        """The machine's clock for timers."""
        return self.clock.awake()

    def __del__(self) -> None:
        """Has no effect: the loop has no resources of the real computer, so it need not be closed."""

    # --- external events ------------------------------------------------------------------------------

    def enter(self, event: Callable[[], object]) -> None:
        """Runs the loop for an external event, if the process can run."""
        if self.dead:
            return
        if self.frozen or self._held:
            self._backlog.append(event)
            return
        self.call_soon(event)
        self._run()

    def soon(self, event: Callable[[], object], seconds: float = 0.0) -> None:
        """Schedules an external event."""
        self._timeline.after(seconds, lambda: self.enter(event))

    def freeze(self) -> None:
        """Stops the process as by SIGSTOP."""
        self.frozen = True

    def thaw(self) -> None:
        """Continues as by SIGCONT: pending events and expired timers, all at once."""
        if self.frozen and not self.dead:
            self.frozen = False
            self._catch_up()

    def die(self) -> None:
        """Ends the process as by SIGKILL: its coroutines neither continue nor unwind (`_pinned`)."""
        self.dead = True
        self._backlog.clear()
        if self._wake is not None:
            self._wake.cancel()

    def compute(self, seconds: float) -> None:
        """Adds the duration of the present work; meanwhile the process handles no event."""
        self._charged_seconds += seconds
        if self._charged_seconds >= TIMER_GRAIN:
            self.hold(self._charged_seconds)
            self._charged_seconds = 0.0

    def hold(self, seconds: float = 0.0) -> None:
        """After the present work, the process handles no event for so many seconds."""
        self._hold = (self._hold or 0.0) + seconds
        self.stop()

    # --- the loop -------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._rounds = 0
        self._until_stopped()
        if self._hold is not None:
            self._held = True
            self._timeline.after(self._hold, self._release)
            self._hold = None

    def _until_stopped(self) -> None:
        """As `run_forever`, but with generator hooks for all loops at once: see `closing_generators`."""
        self._check_running()
        self._thread_id = threading.get_ident()
        asyncio._set_running_loop(self)
        try:
            while not self._stopping:
                self._run_once()
        finally:
            self._stopping, self._thread_id = False, None
            asyncio._set_running_loop(None)

    def _release(self) -> None:
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
        """Ends the run of a loop without work for so many seconds of its clock, None for ever."""
        self._rounds += 1
        if timeout == 0 and self._rounds < ROUNDS:
            return
        self.stop()
        if timeout is not None:
            due = self.clock.true(self.time() + (timeout or ROUND_TIME))
            self._wake_at(max(due, self._timeline.now + TICK))

    def _wake_at(self, when: float) -> None:
        if self._wake is not None:
            if self._wake_time <= when and self._wake.event is not None:
                return
            self._wake.cancel()
        self._wake_time = when
        self._wake = self._timeline.at(when, self._on_wake)

    def _on_wake(self) -> None:
        self._wake = None
        self._wake_time = math.inf
        if self.dead:
            return
        if self.frozen or self._held:
            self._backlog.append(_nothing)
            return
        self._run()

    def _process_events(self, events: object) -> None:
        """Has no effect: the loop has no I/O."""

    def _write_to_self(self) -> None:
        """Has no effect: the process has no threads."""

    # Any executor is accepted, since there are no threads.
    def run_in_executor(self, _: object, func: Callable[..., Any], *args: Any) -> Any:  # type: ignore[override]
        """Runs work of a thread, mostly of a disk: it takes time while others continue."""
        future = self.create_future()

        def done() -> None:
            if future.done():
                return
            try:
                future.set_result(func(*args))
            except Exception as error:
                future.set_exception(error)

        self.soon(done, THREAD_TIME)
        return future


def _pinned(
    loop: asyncio.AbstractEventLoop, coro: Coroutine[Any, Any, Any], **more: Any
) -> asyncio.Task[Any]:
    """A task that stays referenced until it has ended, or until `release`.

    A freed coroutine is unwound: its `finally` blocks run. SIGKILL does not do that, so the tasks of a dead
    process must not be freed during the simulation.
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


def release(machine: SimulatedMachine) -> None:
    """Frees the remaining tasks of a machine's processes, when none runs on it any more.

    The simulation has ended: effects and exceptions of `finally` blocks are ignored.
    """
    with warnings.catch_warnings():
        # A `finally` block may create a coroutine that is never awaited.
        warnings.simplefilter("ignore")
        while machine.pinned:
            task = machine.pinned.pop()
            # asyncio would report a task that is freed before its end.
            loop = task.get_loop()
            loop.set_exception_handler(lambda loop, context: None)
            # A task that a `finally` block starts belongs to this loop, and is unwound next.
            running = asyncio._get_running_loop()
            asyncio._set_running_loop(loop)
            try:
                _unwind(task.get_coro())
            finally:
                asyncio._set_running_loop(running)
            abandon(task)
            _unpin(task)


def _unwind(coroutine: Any) -> None:
    """Closes a coroutine, also one that awaits in a `finally` block."""
    for _ in range(MAX_UNWINDS):
        try:
            coroutine.close()
        except Exception:
            continue
        return


def _nothing() -> None:
    pass
