"""The time that a host sends to its peers and accepts from them."""

from __future__ import annotations

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.identity import NO_RIGHTS, Identity
from lfield.authority.key_material import Keys
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.wire.messages import Hello

BEGIN, END = 1.7e9, 1.9e9
HELLO = Hello("host", "alpha", 1)


def admission_of(name: str, clock: float) -> CertificateAdmission:
    own = Identity("host", name, NO_RIGHTS, f"{name}-serial", BEGIN, END, "ours")
    return CertificateAdmission(Keys("host", b"", b"", b""), own, TrustedClock(ManualClock(clock)))


def test_false_time_of_a_host_is_not_forwarded() -> None:
    """Two hosts that forward received times would keep a false time forever."""
    alpha, bravo = (admission_of(name, 1.75e9) for name in ("alpha", "bravo"))
    false_host = Identity("host", "false_host", NO_RIGHTS, "c", BEGIN, END, "ours")
    alpha.on_handshake(false_host, Hello("host", "false_host", 1, time=1.89e9))
    assert alpha.time.now() == 1.89e9
    assert "since host false_host has sent that time" in alpha.clock_warning()
    bravo.on_handshake(alpha.own, alpha.sign_hello(HELLO))
    assert bravo.time.now() == 1.75e9


def test_host_without_a_clock_accepts_the_time_of_a_peer() -> None:
    pi, alpha = admission_of("pi", 5.0), admission_of("alpha", 1.75e9)
    assert pi.time.now() == BEGIN
    pi.on_handshake(alpha.own, alpha.sign_hello(HELLO))
    assert pi.time.now() == 1.75e9
