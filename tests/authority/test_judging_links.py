"""Whether somebody may be linked with now, row by row of the judge's table; and who may have signed."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from lfield.authority.identity import ALL, NONE, STRANGER, Identity, Kind, Right
from lfield.authority.judge import (
    NO_CHECK_TIME,
    Known,
    Revoked,
    Verdict,
    judged,
    judged_signer,
    when,
)

OURS, THEIRS = "a" * 64, "b" * 64
BRAVO = Identity("host", "bravo", NONE, "b1", 1000.0, 2000.0, OURS)
ANNA = Identity("person", "anna", ALL, "a1", 1000.0, 2000.0, OURS)
LISTED = Revoked(3, frozenset({"b1", "a1"}), 1500.0)


def extent(who: Identity, at: float = 1500.0, **options) -> str:
    return judged(who, at=at, authority=OURS, **options).extent


@pytest.mark.parametrize("who", [BRAVO, ANNA], ids=str)
def test_all_is_well(who: Identity) -> None:
    assert judged(who, at=1500.0, authority=OURS) == Verdict("all")
    assert extent(who, 1000.0) == "all"
    assert extent(who, math.nextafter(2000.0, 0.0)) == "all"


@pytest.mark.parametrize("who", [BRAVO, ANNA], ids=str)
@pytest.mark.parametrize(
    ("known", "flies", "left"),
    [
        ("new", False, "nothing"),
        ("new", True, "nothing"),
        ("greeted", False, "nothing"),
        ("greeted", True, "finish"),
        ("linked", False, "nothing"),
        ("linked", True, "finish"),
    ],
)
def test_one_that_has_ended_may_finish_if_it_is_known_and_flies(
    who: Identity, known: Known, flies: bool, left: str
) -> None:
    found = judged(who, at=2000.0, authority=OURS, known=known, flies=flies)
    assert found.extent == left
    assert found.why == (
        f"the certificate of {who} ended 1970-01-01 00:33 UTC: renew it with 'lfield keys renew "
        f"{who.kind} {who.name}'"
    )


@pytest.mark.parametrize("kind", ["host", "person"])
@pytest.mark.parametrize("known", ["new", "greeted", "linked"])
@pytest.mark.parametrize("flies", [False, True])
def test_one_that_is_revoked_keeps_no_link_but_that_of_a_host_that_flies(
    kind: Kind, known: Known, flies: bool
) -> None:
    who = BRAVO if kind == "host" else ANNA
    found = judged(who, at=1500.0, authority=OURS, revoked=LISTED, known=known, flies=flies)
    assert found.extent == ("finish" if (kind, known, flies) == ("host", "linked", True) else "nothing")
    assert f"the keys of {who} are revoked (list 3)" in found.why
    assert extent(replace(who, serial="c1"), revoked=LISTED) == "all"


def test_one_that_has_not_begun_says_to_set_the_clock() -> None:
    found = judged(BRAVO, at=999.0, authority=OURS, known="linked", flies=True)
    assert found.extent == "nothing"
    assert "set the clock" in found.why


def test_strangers_and_those_of_another_authority_get_nothing() -> None:
    assert extent(STRANGER, known="linked", flies=True) == "nothing"
    found = judged(replace(BRAVO, authority=THEIRS), at=1500.0, authority=OURS, known="linked", flies=True)
    assert found.extent == "nothing"
    assert f"is of the authority {THEIRS[:12]}, and ours is {OURS[:12]}" in found.why


def test_who_is_dialled_must_answer() -> None:
    assert extent(BRAVO, expected="bravo") == "all"
    found = judged(BRAVO, at=1500.0, authority=OURS, expected="alpha")
    assert found == Verdict(
        "nothing",
        "host bravo answers where host alpha should: correct the address, or the keys there",
    )
    assert extent(replace(ANNA, name="alpha"), expected="alpha") == "nothing"


def test_the_kernel_vouches_for_users_of_this_computer() -> None:
    assert extent(Identity("local", "root", ALL), at=1e12) == "all"


def test_what_is_left_of_rights() -> None:
    assert Verdict("all").left(ALL) == ALL
    assert Verdict("finish").left(ALL) == {Right.OBSERVE, Right.STOP}
    assert Verdict("finish").left(frozenset({Right.COMMAND})) == NONE
    assert Verdict("nothing").left(ALL) == NONE


def signer(who: Identity = ANNA, signed: float = 1200.0, at: float = 1500.0, **options) -> Verdict:
    return judged_signer(who, signed, at=at, authority=OURS, **options)


def test_who_may_command_may_sign() -> None:
    assert signer() == Verdict("all")
    may_not = replace(ANNA, may=ALL - {Right.COMMAND})
    assert signer(may_not) == Verdict(
        "nothing", "anna may not sign bundles: that takes keys that may 'command'"
    )
    assert signer(replace(BRAVO, may=ALL)).extent == "nothing"
    assert signer(replace(ANNA, authority=THEIRS)).extent == "nothing"
    assert signer(STRANGER).extent == "nothing"


def test_a_signature_is_of_a_time_in_which_the_certificate_held() -> None:
    for signed in (999.0, 2000.0):
        assert "was not valid" in signer(signed=signed, runs=True).why


def test_what_runs_already_goes_on_when_its_signer_ends() -> None:
    for options in ({"at": 2000.0}, {"revoked": LISTED}):
        found = signer(**options)
        assert found.extent == "nothing"
        assert "sign it again with 'lfield sign'" in found.why
        going_on = signer(**options, runs=True)
        assert (going_on.extent, going_on.why) == ("all", found.why)


def test_times_for_people() -> None:
    assert when(1795464000.0) == "2026-11-23 20:00 UTC"
    assert when(math.inf) == when(math.nan) == when(1e300) == "at no time"


def test_openssl_knows_the_flag_by_this_number() -> None:
    """x509_vfy.h: X509_V_FLAG_NO_CHECK_TIME."""
    assert NO_CHECK_TIME == 0x200000
