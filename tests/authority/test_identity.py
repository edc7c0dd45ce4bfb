"""The identity in a certificate that `getpeercert()` returns."""

from __future__ import annotations

import math
import ssl
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import (
    ALL_RIGHTS,
    ANONYMOUS,
    NO_RIGHTS,
    Identity,
    Right,
    from_uris,
    identity_of,
    seconds_of,
    sorted_rights,
    uri_of,
    with_implied,
)

FINGERPRINT = "ab" * 32


def peer(*uris: str, **changed: Any) -> dict[str, Any]:
    """A peer's certificate as the ssl module describes it."""
    return {
        "subject": ((("commonName", "alpha"),),),
        "issuer": ((("organizationName", "lfield"),), (("commonName", FINGERPRINT),)),
        "version": 3,
        "serialNumber": "0A1B",
        "notBefore": "Nov 23 20:00:00 2026 GMT",
        "notAfter": "Nov  3 20:00:00 2027 GMT",
        "subjectAltName": (*(("URI", uri) for uri in uris),),
    } | changed


def test_identity_of_a_host_and_of_a_person() -> None:
    begins, ends = 1795464000.0, 1825272000.0
    assert identity_of(peer("lfield://host/alpha")) == Identity(
        "host", "alpha", NO_RIGHTS, "a1b", begins, ends, FINGERPRINT
    )
    assert identity_of(peer("lfield://person/anna?may=observe,stop")) == Identity(
        "person", "anna", frozenset({Right.OBSERVE, Right.STOP}), "a1b", begins, ends, FINGERPRINT
    )


def test_foreign_names_beside_an_lfield_name_are_ignored() -> None:
    certificate = peer("https://example.org/", "lfield://host/alpha")
    certificate["subjectAltName"] += (("DNS", "beta"),)
    assert identity_of(certificate).name == "alpha"


@pytest.mark.parametrize(
    "uris",
    [
        (),
        ("https://example.org/host/alpha",),
        ("lfield://host/alpha", "lfield://host/beta"),
        ("lfield://host/alpha", "LFIELD://host/beta"),
        ("lfield://host/",),
        ("lfield://host/alpha/beta",),
        ("lfield://host/alpha?may=command",),
        ("lfield://host/%61lpha",),
        ("lfield://host/al%0Apha",),
        ("lfield://host/%FF",),
        ("lfield://host/" + "a" * 129,),
        ("lfield://local/root",),
        ("lfield://person/anna",),
        ("lfield://person/anna?may=observe#x",),
        ("lfield://person/anna?may=observe\n",),
    ],
)
def test_malformed_lfield_name_is_anonymous(uris: tuple[str, ...]) -> None:
    assert identity_of(peer(*uris)) is ANONYMOUS
    assert from_uris(uris, serial=1, valid_from=0.0, valid_until=1.0, authority=FINGERPRINT) is ANONYMOUS


@pytest.mark.parametrize(
    "changed",
    [
        {"serialNumber": "x"},
        {"notBefore": "Foo 23 20:00:00 2026 GMT"},
        {"notAfter": "soon"},
        {"issuer": ((("commonName", "other"),),)},
        {"issuer": ()},
    ],
)
def test_malformed_certificate_field_is_anonymous(changed: dict[str, Any]) -> None:
    assert identity_of(peer("lfield://host/alpha", **changed)) is ANONYMOUS
    assert identity_of({}) is ANONYMOUS


def test_unknown_right_is_left_out() -> None:
    found = identity_of(peer("lfield://person/anna?may=observe,teleport"))
    assert found.may == {Right.OBSERVE}


def test_rights_imply_others() -> None:
    assert with_implied([Right.OPERATE]) == {Right.OPERATE, Right.STOP, Right.OBSERVE}
    assert with_implied([Right.STOP]) == {Right.STOP, Right.OBSERVE}
    assert with_implied([Right.COMMAND]) == {Right.COMMAND}
    assert sorted_rights(ALL_RIGHTS) == "observe,stop,operate,command"


def test_text_form_of_identities() -> None:
    assert str(Identity("host", "alpha", NO_RIGHTS)) == "host alpha"
    assert str(Identity("person", "anna", NO_RIGHTS)) == "anna"
    assert str(Identity("local", "root", ALL_RIGHTS)) == "user root of this computer"
    assert str(ANONYMOUS) == "an unauthenticated peer"
    assert Identity("local", "root", ALL_RIGHTS).valid_until == math.inf


NAMES = st.text(min_size=1, max_size=30).filter(str.isprintable)


@given(NAMES, st.frozensets(st.sampled_from(Right)))
def test_any_name_and_rights_are_read_back(name: str, may: frozenset[Right]) -> None:
    person = identity_of(peer(uri_of("person", name, may)))
    assert (person.kind, person.name, person.may) == ("person", name, may)
    host = identity_of(peer(uri_of("host", name)))
    assert (host.kind, host.name, host.may) == ("host", name, NO_RIGHTS)


@given(st.text() | st.integers() | st.none())
def test_no_certificate_content_raises(text: Any) -> None:
    identity_of(peer(text if isinstance(text, str) else "lfield://host/alpha", serialNumber=text))


@pytest.mark.parametrize(
    "text", ["Nov 23 20:00:00 2026 GMT", "Jan  1 00:00:00 1970 GMT", "Feb 29 23:59:59 2028 GMT"]
)
def test_certificate_times_are_parsed_like_ssl(text: str) -> None:
    assert seconds_of(text) == ssl.cert_time_to_seconds(text)
