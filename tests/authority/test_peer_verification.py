"""Admission of peers, one test per row of the decision table, and permitted signers of bundles."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from lfield.authority.identity import ALL_RIGHTS, ANONYMOUS, NO_RIGHTS, Identity, Kind, Right
from lfield.authority.peer_verification import (
    NO_CHECK_TIME,
    AdmissionDecision,
    PeerStage,
    RevocationList,
    format_time,
    verify_peer,
    verify_signer,
)

OURS, THEIRS = "a" * 64, "b" * 64
BRAVO = Identity("host", "bravo", NO_RIGHTS, "b1", 1000.0, 2000.0, OURS)
ANNA = Identity("person", "anna", ALL_RIGHTS, "a1", 1000.0, 2000.0, OURS)
LISTED = RevocationList(3, frozenset({"b1", "a1"}), 1500.0)


def extent_of(who: Identity, at: float = 1500.0, **options) -> str:
    return verify_peer(who, at=at, authority=OURS, **options).extent


@pytest.mark.parametrize("who", [BRAVO, ANNA], ids=str)
def test_valid_peer_is_admitted(who: Identity) -> None:
    assert verify_peer(who, at=1500.0, authority=OURS) == AdmissionDecision("all")
    assert extent_of(who, 1000.0) == "all"
    assert extent_of(who, math.nextafter(2000.0, 0.0)) == "all"


@pytest.mark.parametrize("who", [BRAVO, ANNA], ids=str)
@pytest.mark.parametrize(
    ("known", "is_active", "extent"),
    [
        ("new", False, "nothing"),
        ("new", True, "nothing"),
        ("greeted", False, "nothing"),
        ("greeted", True, "finish"),
        ("linked", False, "nothing"),
        ("linked", True, "finish"),
    ],
)
def test_expired_peer_may_finish_an_active_mission(
    who: Identity, known: PeerStage, is_active: bool, extent: str
) -> None:
    found = verify_peer(who, at=2000.0, authority=OURS, known=known, is_mission_active=is_active)
    assert found.extent == extent
    assert found.reason == (
        f"the certificate of {who} expired 1970-01-01 00:33 UTC, and the clock here shows 1970-01-01: "
        f"set the clock if it is wrong, else renew it with 'lfield keys renew {who.kind} {who.name}'"
    )


@pytest.mark.parametrize("kind", ["host", "person"])
@pytest.mark.parametrize("known", ["new", "greeted", "linked"])
@pytest.mark.parametrize("is_active", [False, True])
def test_revoked_host_keeps_only_its_link_during_a_mission(
    kind: Kind, known: PeerStage, is_active: bool
) -> None:
    identity = BRAVO if kind == "host" else ANNA
    found = verify_peer(
        identity, at=1500.0, authority=OURS, revoked=LISTED, known=known, is_mission_active=is_active
    )
    assert found.extent == ("finish" if (kind, known, is_active) == ("host", "linked", True) else "nothing")
    assert f"the keys of {identity} are revoked (list 3)" in found.reason
    assert extent_of(replace(identity, serial="c1"), revoked=LISTED) == "all"


def test_certificate_of_the_future_suggests_setting_the_clock() -> None:
    found = verify_peer(BRAVO, at=999.0, authority=OURS, known="linked", is_mission_active=True)
    assert found.extent == "nothing"
    assert "set the clock" in found.reason


def test_anonymous_and_foreign_peers_are_refused() -> None:
    assert extent_of(ANONYMOUS, known="linked", is_mission_active=True) == "nothing"
    found = verify_peer(
        replace(BRAVO, authority=THEIRS), at=1500.0, authority=OURS, known="linked", is_mission_active=True
    )
    assert found.extent == "nothing"
    assert f"is of the authority {THEIRS[:12]}, and ours is {OURS[:12]}" in found.reason


def test_answer_of_another_host_is_refused() -> None:
    assert extent_of(BRAVO, expected="bravo") == "all"
    found = verify_peer(BRAVO, at=1500.0, authority=OURS, expected="alpha")
    assert found == AdmissionDecision(
        "nothing",
        "host bravo answers at the address of host alpha: correct the address, or the keys there",
    )
    assert extent_of(replace(ANNA, name="alpha"), expected="alpha") == "nothing"


def test_local_user_is_admitted() -> None:
    assert extent_of(Identity("local", "root", ALL_RIGHTS), at=1e12) == "all"


def test_remaining_rights_by_extent() -> None:
    assert AdmissionDecision("all").remaining_rights(ALL_RIGHTS) == ALL_RIGHTS
    assert AdmissionDecision("finish").remaining_rights(ALL_RIGHTS) == {Right.OBSERVE, Right.STOP}
    assert AdmissionDecision("finish").remaining_rights(frozenset({Right.COMMAND})) == NO_RIGHTS
    assert AdmissionDecision("nothing").remaining_rights(ALL_RIGHTS) == NO_RIGHTS


def signer(who: Identity = ANNA, signed: float = 1200.0, at: float = 1500.0, **options) -> AdmissionDecision:
    return verify_signer(who, signed, at=at, authority=OURS, **options)


def test_only_persons_with_the_command_right_may_sign() -> None:
    assert signer() == AdmissionDecision("all")
    without_command = replace(ANNA, may=ALL_RIGHTS - {Right.COMMAND})
    assert signer(without_command) == AdmissionDecision(
        "nothing", "anna may not sign bundles: that takes keys that may 'command'"
    )
    assert signer(replace(BRAVO, may=ALL_RIGHTS)).extent == "nothing"
    assert signer(replace(ANNA, authority=THEIRS)).extent == "nothing"
    assert signer(ANONYMOUS).extent == "nothing"


def test_signature_outside_the_validity_period_is_refused() -> None:
    for signed in (999.0, 2000.0):
        assert "was not valid" in signer(signed=signed, runs=True).reason


def test_running_bundle_continues_after_its_signer_expires() -> None:
    for options in ({"at": 2000.0}, {"revoked": LISTED}):
        found = signer(**options)
        assert found.extent == "nothing"
        assert "sign it again with 'lfield sign'" in found.reason
        running = signer(**options, runs=True)
        assert (running.extent, running.reason) == ("all", found.reason)


def test_times_are_formatted_in_utc() -> None:
    assert format_time(1795464000.0) == "2026-11-23 20:00 UTC"
    assert format_time(math.inf) == format_time(math.nan) == format_time(1e300) == "at no time"


def test_no_check_time_flag_has_the_value_of_openssl() -> None:
    """x509_vfy.h: X509_V_FLAG_NO_CHECK_TIME."""
    assert NO_CHECK_TIME == 0x200000
