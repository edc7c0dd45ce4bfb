"""What a host tells others of the time, and what it takes from them."""

from __future__ import annotations

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.identity import NO_RIGHTS, Identity
from lfield.authority.key_material import Keys
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.wire.messages import Hello

BEGIN, END = 1.7e9, 1.9e9
HELLO = Hello("host", "alpha", 1)


def judge_of(name: str, clock: float) -> CertificateAdmission:
    own = Identity("host", name, NO_RIGHTS, f"{name}-serial", BEGIN, END, "ours")
    return CertificateAdmission(Keys("host", b"", b"", b""), own, TrustedClock(ManualClock(clock)))


def test_a_lie_about_the_time_is_gone_with_the_liar() -> None:
    """Two hosts that passed on what they were told would tell it to each other for ever."""
    alpha, bravo = (judge_of(name, 1.75e9) for name in ("alpha", "bravo"))
    liar = Identity("host", "liar", NO_RIGHTS, "c", BEGIN, END, "ours")
    alpha.on_handshake(liar, Hello("host", "liar", 1, time=1.89e9))
    assert alpha.time.now() == 1.89e9
    assert "since host liar has sent that time" in alpha.clock_warning()
    bravo.on_handshake(alpha.own, alpha.sign_hello(HELLO))
    assert bravo.time.now() == 1.75e9


def test_a_host_without_a_clock_takes_the_time_of_one_that_has() -> None:
    pi, alpha = judge_of("pi", 5.0), judge_of("alpha", 1.75e9)
    assert pi.time.now() == BEGIN
    pi.on_handshake(alpha.own, alpha.sign_hello(HELLO))
    assert pi.time.now() == 1.75e9
