"""The trusted time of computers whose clock may have started in 1970."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import ANONYMOUS, NO_RIGHTS, Identity
from lfield.authority.trusted_clock import TrustedClock

BRAVO = Identity("host", "bravo", NO_RIGHTS, "b1", 1.7e9, 1.9e9, "a" * 64)


class ComputerClock:
    """The system clock of a computer that started `up` seconds ago; it showed `wall` at the start."""

    def __init__(self, wall: float = 0.0, up: float = 5.0) -> None:
        self.wall, self.up = wall, up

    def monotonic(self) -> float:
        return self.up

    def time(self) -> float:
        return self.wall + self.up

    def wait(self, seconds: float) -> None:
        self.up += seconds


def test_correct_clock_is_trusted_without_a_warning() -> None:
    trusted = TrustedClock(ComputerClock(1.8e9), journal_time=1.79e9)
    trusted.on_signature(1.75e9, "the certificate of host bravo")
    trusted.on_peer_time(1.8e9, BRAVO)
    assert trusted.now() == 1.8e9 + 5.0
    assert trusted.warning() is None


def test_clock_of_1970_continues_from_the_journal_time() -> None:
    clock = ComputerClock()
    trusted = TrustedClock(clock, journal_time=1.8e9)
    clock.wait(100.0)
    assert trusted.now() == 1.8e9 + 100.0
    assert trusted.warning() == (
        "system clock behind: it shows 1970-01-01 00:01 UTC, but the time is at least 2027-01-15 08:01 UTC, "
        "since the journal of this host has that time; set the clock"
    )


def test_start_of_a_signed_certificate_is_a_lower_bound() -> None:
    trusted = TrustedClock(ComputerClock())
    trusted.on_signature(1.75e9, "the certificate of host bravo")
    trusted.on_signature(1.72e9, "the certificate of host alpha")
    assert trusted.now() == 1.75e9
    assert "since the certificate of host bravo began then" in trusted.warning()


def test_peer_time_is_trusted_within_its_certificate() -> None:
    trusted = TrustedClock(ComputerClock())
    trusted.on_peer_time(1.8e9, BRAVO)
    assert trusted.now() == 1.8e9
    assert "since host bravo has sent that time" in trusted.warning()
    for beyond in (BRAVO.valid_until, 1e12, math.inf, math.nan, -math.inf, BRAVO.valid_from - 1.0):
        trusted.on_peer_time(beyond, BRAVO)
        assert trusted.now() == 1.8e9
    trusted.on_peer_time(1.85e9, ANONYMOUS)
    for kind in ("local", "person"):
        trusted.on_peer_time(1.85e9, Identity(kind, "root", NO_RIGHTS))
    assert trusted.now() == 1.8e9


def test_peer_time_is_not_forwarded() -> None:
    clock = ComputerClock()
    trusted = TrustedClock(clock, journal_time=1.7e9)
    trusted.on_peer_time(1.8e9, BRAVO)
    assert trusted.for_handshake() == 1.7e9
    trusted.on_signature(1.75e9, "list 3")
    clock.wait(10.0)
    assert trusted.for_handshake() == 1.75e9 + 10.0
    assert trusted.now() == 1.8e9 + 10.0


def test_slow_clock_is_reported_once_per_reason() -> None:
    clock = ComputerClock()
    trusted = TrustedClock(clock, journal_time=1.7e9)
    assert "the journal of this host has that time" in trusted.warning()
    clock.wait(3600.0)
    assert trusted.warning() is None
    trusted.on_peer_time(1.8e9, BRAVO)
    assert "since host bravo has sent that time" in trusted.warning()
    assert trusted.warning() is None


def test_corrected_clock_is_trusted_again() -> None:
    clock = ComputerClock()
    trusted = TrustedClock(clock, journal_time=1.7e9)
    assert trusted.warning()
    clock.wall = 1.8e9
    assert trusted.now() == clock.time()
    assert trusted.warning() is None


@given(st.floats(allow_nan=True), st.floats(0.0, 1e10))
def test_peer_time_never_decreases_the_trusted_time(peer_time: float, journal_time: float) -> None:
    trusted = TrustedClock(ComputerClock(), journal_time)
    before = trusted.now()
    trusted.on_peer_time(peer_time, BRAVO)
    assert before <= trusted.now() < max(before + 1e-6, BRAVO.valid_until)
