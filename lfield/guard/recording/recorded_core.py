"""A GuardCore with one time per input, whose inputs and decisions are recorded.

The core reads its clock several times in one event. With one time for all readings, this time is an input
like the others, and a replay is bit-exact.
"""

from __future__ import annotations

from lfield.guard.core import GuardCore
from lfield.guard.effects import Effect, Execute, Interrupt
from lfield.guard.messages import GuardCall
from lfield.guard.recording.guard_inputs import CallStarting, GuardInput, apply_input
from lfield.guard.recording.guard_recorder import GuardRecorder
from lfield.recording.turn_clocks import TurnClock


class RecordedCore:
    """The core of a guard; `clock` is the clock of the core. Without a `recorder`, no data is recorded.

    Each input reads the clock once. A recording is a sequence of segments, each of which begins with the
    state of the core and the accepted calls that the driver has not started.
    """

    def __init__(self, core: GuardCore, clock: TurnClock, recorder: GuardRecorder | None) -> None:
        self._core, self._clock, self._recorder = core, clock, recorder
        #: The time when the next timer must expire; None without a deadline.
        self.due = core.due
        #: The accepted calls that the driver has not started, by token: a segment must contain them.
        self._unstarted: dict[int, GuardCall] = {}
        if recorder is not None:
            recorder.start(core.state, ())

    def handle(self, event: GuardInput) -> list[Effect]:
        """The effects of an input."""
        now = self._clock.latch()
        effects = apply_input(self._core, event)
        if self._recorder is None:
            return effects
        for effect in effects:
            if isinstance(effect, Execute):
                self._unstarted[effect.call.token] = effect.call
            elif isinstance(effect, Interrupt):
                self._unstarted.pop(effect.token, None)
        self._recorder.on_input(now, event, effects)
        self._start_segment_if_full()
        return effects

    def start_call(self, call: GuardCall) -> str:
        """The reason why the driver must not start an accepted call any more; '' when the call starts now."""
        now = self._clock.latch()
        refusal = self._core.mark_started(call)
        if self._recorder is not None:
            self._unstarted.pop(call.token, None)
            self._recorder.on_call_start(now, CallStarting(call.token), refusal)
            self._start_segment_if_full()
        return refusal

    def _start_segment_if_full(self) -> None:
        assert self._recorder is not None
        if self._recorder.is_full:
            self._recorder.start(self._core.state, tuple(self._unstarted.values()))
