"""What time it is, for computers whose clock may have begun in 1970."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import ANONYMOUS, NO_RIGHTS, Identity
from lfield.authority.trusted_clock import TrustedClock

BRAVO = Identity("host", "bravo", NO_RIGHTS, "b1", 1.7e9, 1.9e9, "a" * 64)


class Pi:
    """A clock that began in 1970, or at `wall`, `up` seconds ago."""

    def __init__(self, wall: float = 0.0, up: float = 5.0) -> None:
        self.wall, self.up = wall, up

    def monotonic(self) -> float:
        return self.up

    def time(self) -> float:
        return self.wall + self.up

    def wait(self, seconds: float) -> None:
        self.up += seconds


def test_a_good_clock_is_believed_and_nothing_is_said() -> None:
    believed = TrustedClock(Pi(1.8e9), journal_time=1.79e9)
    believed.on_signature(1.75e9, "the certificate of host bravo")
    believed.on_peer_time(1.8e9, BRAVO)
    assert believed.now() == 1.8e9 + 5.0
    assert believed.warning() is None


def test_a_clock_of_1970_goes_on_from_what_was_kept() -> None:
    clock = Pi()
    believed = TrustedClock(clock, journal_time=1.8e9)
    clock.wait(100.0)
    assert believed.now() == 1.8e9 + 100.0
    assert believed.warning() == (
        "system clock behind: it shows 1970-01-01 00:01 UTC, and it is at least 2027-01-15 08:01 UTC, since "
        "the journal of this host has that time; set the clock"
    )


def test_what_the_authority_has_signed_began_already() -> None:
    believed = TrustedClock(Pi())
    believed.on_signature(1.75e9, "the certificate of host bravo")
    believed.on_signature(1.72e9, "the certificate of host alpha")
    assert believed.now() == 1.75e9
    assert "since the certificate of host bravo began then" in believed.warning()


def test_the_team_is_believed_within_its_own_certificates() -> None:
    believed = TrustedClock(Pi())
    believed.on_peer_time(1.8e9, BRAVO)
    assert believed.now() == 1.8e9
    assert "since host bravo has sent that time" in believed.warning()
    for beyond in (BRAVO.valid_until, 1e12, math.inf, math.nan, -math.inf, BRAVO.valid_from - 1.0):
        believed.on_peer_time(beyond, BRAVO)
        assert believed.now() == 1.8e9
    believed.on_peer_time(1.85e9, ANONYMOUS)
    for kind in ("local", "person"):
        believed.on_peer_time(1.85e9, Identity(kind, "root", NO_RIGHTS))
    assert believed.now() == 1.8e9


def test_what_the_team_says_is_not_passed_on() -> None:
    clock = Pi()
    believed = TrustedClock(clock, journal_time=1.7e9)
    believed.on_peer_time(1.8e9, BRAVO)
    assert believed.for_handshake() == 1.7e9
    believed.on_signature(1.75e9, "list 3")
    clock.wait(10.0)
    assert believed.for_handshake() == 1.75e9 + 10.0
    assert believed.now() == 1.8e9 + 10.0


def test_a_clock_that_stays_behind_is_told_once_for_each_reason() -> None:
    clock = Pi()
    believed = TrustedClock(clock, journal_time=1.7e9)
    assert "the journal of this host has that time" in believed.warning()
    clock.wait(3600.0)
    assert believed.warning() is None
    believed.on_peer_time(1.8e9, BRAVO)
    assert "since host bravo has sent that time" in believed.warning()
    assert believed.warning() is None


def test_a_clock_that_is_set_is_believed_again() -> None:
    clock = Pi()
    believed = TrustedClock(clock, journal_time=1.7e9)
    assert believed.warning()
    clock.wall = 1.8e9
    assert believed.now() == clock.time()
    assert believed.warning() is None


@given(st.floats(allow_nan=True), st.floats(0.0, 1e10))
def test_nobody_turns_the_time_back(word: float, kept: float) -> None:
    believed = TrustedClock(Pi(), kept)
    before = believed.now()
    believed.on_peer_time(word, BRAVO)
    assert before <= believed.now() < max(before + 1e-6, BRAVO.valid_until)
