"""What a host tells others of the time, and what it takes from them."""

from __future__ import annotations

from lfield.authority.admission import Judged
from lfield.authority.believed import BelievedTime
from lfield.authority.identity import NONE, Identity
from lfield.authority.keys import Keys
from lfield.clock import ManualClock
from lfield.wire.messages import Hello

BEGIN, END = 1.7e9, 1.9e9
HELLO = Hello("host", "alpha", 1)


def judge_of(name: str, clock: float) -> Judged:
    own = Identity("host", name, NONE, f"{name}-serial", BEGIN, END, "ours")
    return Judged(Keys("host", b"", b"", b""), own, BelievedTime(ManualClock(clock)))


def test_a_lie_about_the_time_is_gone_with_the_liar() -> None:
    """Two hosts that passed on what they were told would tell it to each other for ever."""
    alpha, bravo = (judge_of(name, 1.75e9) for name in ("alpha", "bravo"))
    liar = Identity("host", "liar", NONE, "c", BEGIN, END, "ours")
    alpha.greeted(liar, Hello("host", "liar", 1, time=1.89e9))
    assert alpha.time.now() == 1.89e9
    assert "since host liar says so" in alpha.line()
    bravo.greeted(alpha.own, alpha.signed(HELLO))
    assert bravo.time.now() == 1.75e9


def test_a_host_without_a_clock_takes_the_time_of_one_that_has() -> None:
    pi, alpha = judge_of("pi", 5.0), judge_of("alpha", 1.75e9)
    assert pi.time.now() == BEGIN
    pi.greeted(alpha.own, alpha.signed(HELLO))
    assert pi.time.now() == 1.75e9
