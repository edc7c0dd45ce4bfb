"""Reservations under all events in any order, including crashes of their host.

The promise is judged by the requests and answers, not by the state of the core. The same test is run on
cores that are broken on purpose, to show that it can fail.
"""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

from lfield.host.team.reservations import (
    DenyWaiter,
    Effect,
    PersistHolder,
    ReservationDenied,
    Reservations,
    RetryWaiter,
    StartKey,
)

LEASE, WAIT = 6.0, 5.0
starts = st.tuples(st.sampled_from(["pilot", "rover", "scout"]), st.integers(1, 2))


class Reserving(RuleBasedStateMachine):
    """One resource. A coordinator holds it from its grant until its lease expires, it releases it or ends."""

    core_type = Reservations

    def __init__(self) -> None:
        super().__init__()
        self.now, self.first = 0.0, 100
        #: The durable record, and the records on their way to the disk.
        self.disk: PersistHolder | None = None
        self.pages: list[PersistHolder] = []
        self.busy: set[str] = set()
        #: The numbers that were granted, and the holder of the resource, with its number and end.
        self.granted: dict[int, StartKey] = {}
        self.promised: tuple[StartKey, int, float] | None = None
        self.waiting: dict[StartKey, float] = {}
        self.asked: dict[StartKey, str] = {}
        self.core = self._made()

    def _made(self) -> Reservations:
        return self.core_type(self.first, LEASE, lambda _: WAIT, lambda _, agent: bool(self.busy - {agent}))

    # --- events ---------------------------------------------------------------------------------------

    @rule(start=starts, nested=st.booleans())
    def take(self, start: StartKey, nested: bool) -> None:
        if self.asked.get(start, "take") != "take":
            return
        try:
            number = self.core.acquire(start, "arm", self.now, nested=nested)
        except ReservationDenied:
            self._continue(start)
            self._carry_out()
            return
        self._carry_out()
        if number:
            self._on_granted(start, number)
        elif not nested:
            self._waits(start, "take")

    def _waits(self, start: StartKey, wants: str) -> None:
        """A waiting start is frozen, so it requests nothing else."""
        self.asked[start] = wants
        self.waiting.setdefault(start, self.now)

    def _continue(self, start: StartKey) -> None:
        self.waiting.pop(start, None)
        self.asked.pop(start, None)

    def _on_granted(self, start: StartKey, number: int) -> None:
        self._continue(start)
        assert self.disk is not None
        assert (self.disk.number, self.disk.holder) == (number, start)
        assert number > max(self.granted, default=0)
        self._check_no_other_holder(start)
        assert not self.busy - {start[0]} or self.granted.get(number - 1, ("", 0))[0] == start[0]
        self.granted[number] = start
        self.promised = start, number, self.now + LEASE

    def _check_no_other_holder(self, start: StartKey) -> None:
        if self.promised is not None and self.now < self.promised[2]:
            holder = self.promised[0]
            later = holder[0] == start[0] and holder[1] <= start[1]
            assert later, f"{holder} holds it, and {start} gets it"

    @rule(start=starts, number=st.integers(0, 3))
    def call(self, start: StartKey, number: int) -> None:
        """With one of the last numbers, or without one."""
        if self.asked.get(start, "call") != "call":
            return
        granted_number = sorted(self.granted)[-number] if 0 < number <= len(self.granted) else 0
        try:
            begins = self.core.may_serve(start, "arm", granted_number, self.now)
        except ReservationDenied:
            self._continue(start)
            begins = None
        self._carry_out()
        if begins:
            self._begins(start, granted_number)
        elif begins is False:
            self._waits(start, "call")

    def _begins(self, start: StartKey, given: int) -> None:
        self._continue(start)
        if given:
            assert self.promised is not None
            assert self.promised[:2] == (start, given)
            assert self.now < self.promised[2]
            self.promised = start, given, self.now + LEASE
            return
        if self.promised is not None and self.promised[0] != start:
            assert self.now >= self.promised[2]
        self.promised = None

    @rule(start=starts, back=st.integers(1, 2))
    def renew(self, start: StartKey, back: int) -> None:
        if len(self.granted) >= back:
            number = sorted(self.granted)[-back]
            self.core.renew(start, "arm", number, self.now)
            self._carry_out()
            if self.promised and self.promised[:2] == (start, number) and self.now < self.promised[2]:
                self.promised = start, number, self.now + LEASE

    @rule(back=st.integers(1, 2))
    def release(self, back: int) -> None:
        if len(self.granted) >= back:
            number = sorted(self.granted)[-back]
            if self.promised and self.promised[1] == number:
                self.promised = None
            self.core.release("arm", number, self.now)
            self._carry_out()

    @rule(start=starts)
    def ends(self, start: StartKey) -> None:
        self._continue(start)
        if self.promised and self.promised[0] == start:
            self.promised = None
        self.core.on_start_ended(start, "it has ended", self.now)
        self._carry_out()

    @rule(start=starts)
    def gives_up(self, start: StartKey) -> None:
        self._continue(start)
        self.core.abandon_wait(start, self.now)
        self._carry_out()

    @rule(agent=st.sampled_from(["pilot", "rover"]), begins=st.booleans())
    def works(self, agent: str, begins: bool) -> None:
        """Portal calls begin while the resource is not reserved, and end."""
        self.busy = {agent} if begins and not self.core.held else set()

    @precondition(lambda self: self.pages)
    @rule()
    def sync(self) -> None:
        for page in self.pages:
            self.disk = page
            if page.holder is not None:
                self.core.on_durable("arm", page.number, self.now)
        self.pages.clear()
        self._carry_out()

    @rule(seconds=st.sampled_from([0.1, 1.0, 3.0, 7.0]))
    def time(self, seconds: float) -> None:
        until, ticks = self.now + seconds, 0
        while self.core.due is not None and self.core.due <= until:
            self.now = max(self.now, self.core.due)
            self.core.tick(self.now)
            self._carry_out()
            ticks += 1
            assert ticks < 100, "the core is due without end"
        self.now = until
        self.core.tick(self.now)
        self._carry_out()
        held = self.core.held.get("arm")
        if held is not None and self.promised is not None and held.number == self.promised[1]:
            assert self.now < self.promised[2], f"{held.holder} holds it after its lease"
        for start, since in self.waiting.items():
            pending = any(page.holder == start for page in self.pages)
            assert pending or self._is_next(start) or self.now < since + WAIT + 0.01, (
                f"{start} waits without end"
            )

    def _is_next(self, start: StartKey) -> bool:
        return start in [holder for _, holder in self.core.unwritten]

    @rule()
    def crash(self) -> None:
        self.pages.clear()
        self.waiting.clear()
        self.asked.clear()
        self.busy.clear()
        self.core = self._made()
        if self.disk is not None:
            self.core.restore("arm", self.disk.number, self.disk.holder, self.now)
            self.promised = None
        if self.disk is not None and self.disk.holder is not None:
            self.granted[self.disk.number] = self.disk.holder
            self.promised = self.disk.holder, self.disk.number, self.now + LEASE

    # --- effects --------------------------------------------------------------------------------------

    def _carry_out(self) -> None:
        for effect in self.core.drain_effects():
            self._one(effect)

    def _one(self, effect: Effect) -> None:
        match effect:
            case PersistHolder():
                self.pages.append(effect)
                if effect.holder and self.promised and effect.holder[0] == self.promised[0][0]:
                    # A later start takes over, also if it does not wait for the number then.
                    self.promised = None
            case DenyWaiter() | RetryWaiter():
                self._continue(effect.start)


class GrantedBeforeItIsOnDisk(Reservations):
    """Grants a number before it is on disk."""

    def acquire(self, start: StartKey, resource: str, now: float, *, nested: bool) -> int:
        number = super().acquire(start, resource, now, nested=nested)
        found = self._resources[resource]
        if found.holder == start and not number:
            self.on_durable(resource, found.number, now)
            number = super().acquire(start, resource, now, nested=nested)
        return number


class NoWaitAfterARestart(Reservations):
    """Does not wait for the lease of the holder after a restart."""

    def restore(self, resource: str, number: int, holder: StartKey | None, now: float) -> None:
        super().restore(resource, number, None, now)


class NumbersRestartAt1(Reservations):
    """Does not restore the numbers of the journal."""

    def restore(self, resource: str, number: int, holder: StartKey | None, now: float) -> None:
        """Restore nothing."""


REPEATABLE = settings(
    derandomize=True,
    deadline=None,
    max_examples=100,
    stateful_step_count=40,
    suppress_health_check=list(HealthCheck),
)
QUICK = settings(REPEATABLE, phases=[Phase.generate], max_examples=2000)


def test_a_resource_never_has_two_holders() -> None:
    run_state_machine_as_test(Reserving, settings=REPEATABLE)


@pytest.mark.few(1)
@pytest.mark.parametrize("broken", [GrantedBeforeItIsOnDisk, NoWaitAfterARestart, NumbersRestartAt1])
def test_a_broken_reservation_rule_is_found(broken: type[Reservations]) -> None:
    class Broken(Reserving):
        core_type = broken

    with pytest.raises(AssertionError):
        run_state_machine_as_test(Broken, settings=QUICK)
