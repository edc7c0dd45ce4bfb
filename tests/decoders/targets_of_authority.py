"""Proofs of identity and rights: certificates, lists, signatures, handshakes, access files.

Changed certificates and lists are signed again, as only a member of the team could send them.
"""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import gettempdir
from typing import NamedTuple

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from decoder_corpus import fixed
from decoder_missions import mission
from decoder_target import Target
from msgspec.structs import replace
from targets_of_links import pack, unpack

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.bundle_signature import sign_bundle, verify_bundle
from lfield.authority.certificate_authority import new_authority
from lfield.authority.certificate_reader import (
    der_of,
    fingerprint_in,
    identity_in,
    identity_in_der,
    revoked_in,
)
from lfield.authority.identity import MAX_NAME, Right, identity_of, sorted_rights, uri_of
from lfield.authority.key_material import Keys
from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner, verify_order
from lfield.authority.peer_verification import RevocationList, verify_peer
from lfield.authority.pem import certificate_in, private_in
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.errors import KeysError, LfieldError, ProgramError, SignatureError
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.host.stop_orders.order_receiver import OrderPorts, OrderReceiver, PendingCheck
from lfield.mission.access.access_file import read_access
from lfield.mission.access.access_rules import decode_access, encode_access
from lfield.net.tls import TlsIdentity
from lfield.operator.orders.order_protocol import OrderProtocol
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.order_messages import (
    MAGIC,
    CertificateRequest,
    EpochChallenge,
    Epochs,
    RelayedOrder,
    SignedAnswer,
    SignedOrder,
    decode_answer,
    decode_datagram,
    decode_order,
    encode_datagram,
    order_confirmation,
)

NOT_BEFORE, END = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2026, 2099))
#: The DER fields between a signed body and its signature: the algorithm Ed25519, and the signature's length.
_ED25519, _BITS = bytes.fromhex("300506032b6570"), bytes.fromhex("03410000")[:3]
DIGEST = bytes(32)
ACCESS = """people:
  anna: [observe, stop, operate]
  others: [observe]
coordinators:
  tom:
    Bell: [ring, slow]
    bell: all
    Lift: all
  Idler: {others: [slow], horn: []}
  others: all
"""


class Made(NamedTuple):
    """An authority with its keys and certificates in PEM and its revocation list in DER."""

    authority: bytes
    key: bytes
    host: bytes
    host_key: bytes
    person: bytes
    person_key: bytes
    revoked: bytes


def _made() -> list[bytes]:
    authority = new_authority(NOT_BEFORE, END)
    host = authority.issue("host", "bravo", at=NOT_BEFORE, ends=END)
    person = authority.issue("person", "anna", may=[*Right], at=NOT_BEFORE, ends=END)
    revoked = authority.revocation_list(RevocationList(3, frozenset({"1f", "a2"}), NOT_BEFORE))
    own = (authority.certificate, authority.key, host.certificate, host.key)
    return [*own, person.certificate, person.key, revoked]


@cache
def team() -> Made:
    """The authority of all inputs."""
    return Made(*fixed("authority", _made))


def signature_of_a_bundle() -> bytes:
    """The signature of a person on a bundle; equal keys give an equal signature."""
    keys_of_team = team()
    return sign_bundle(
        DIGEST,
        Keys("person", keys_of_team.authority, keys_of_team.person, keys_of_team.person_key),
        NOT_BEFORE + 1.0,
    )


@cache
def _signer() -> Ed25519PrivateKey:
    return private_in(team().key)


def resigned(body: bytes) -> bytes:
    """A DER structure with this body, signed by the authority."""
    parts = body + _ED25519 + _BITS + _signer().sign(body)
    length = len(parts).to_bytes((len(parts).bit_length() + 7) // 8 or 1, "big")
    return b"\x30" + (length if len(parts) < 128 else bytes([0x80 | len(length)]) + length) + parts


def decode_certificate(data: bytes) -> None:
    """Decode a certificate with any content and a valid signature; then the unchanged bytes."""
    for certificate in (resigned(data), data):
        with suppress(KeysError):
            identity = identity_in_der(certificate, team().authority)
            verify_peer(identity, at=NOT_BEFORE + 1.0, authority=fingerprint_in(team().authority))
            assert len(identity.name) <= MAX_NAME
            sorted_rights(identity.may)


def decode_list(data: bytes) -> None:
    """Decode a revocation list with a valid signature; then the unchanged bytes."""
    for certificate in (resigned(data), data):
        with suppress(KeysError):
            revoked_in(certificate, team().authority)


def decode_pem(data: bytes) -> None:
    """Decode a file of a key folder: a certificate or a private key."""
    with suppress(KeysError):
        identity_in(data, team().authority)
    with suppress(KeysError):
        private_in(data)
    with suppress(KeysError):
        TlsIdentity(Keys("host", team().authority, data, data))


def decode_names(data: bytes) -> None:
    """Decode the fields of a certificate in the form in which OpenSSL returns them."""
    with suppress(msgspec.MsgspecError, ValueError, RecursionError):
        tree = unpack(data)
        if isinstance(tree, dict):
            identity = identity_of(tree)
            assert identity.kind in ("anonymous", "host", "person")
            str(identity)


def decode_signature(data: bytes) -> None:
    """Decode the signature of a bundle."""
    with suppress(SignatureError):
        verify_bundle(DIGEST, data, team().authority)


def decode_handshake(data: bytes) -> None:
    """Feed bytes of an unauthenticated peer, client or server, in pieces; the first byte gives their size."""
    for calls in (False, True):
        channel, size = _tls().channel(calls=calls), 1 + 4 * (data[0] if data else 0)
        with suppress(LfieldError):
            for at in range(1, len(data), size):
                list(channel.receive(data[at : at + size]))
        assert not channel.proven


@cache
def _tls() -> TlsIdentity:
    return TlsIdentity(Keys("host", team().authority, team().host, team().host_key))


def decode_access_file(data: bytes) -> None:
    """Decode an access file."""
    path, keys_of_team = Path(gettempdir()) / "lfield-fuzz.access.yaml", mission()
    path.write_bytes(data)
    try:
        registry = keys_of_team.registry
        assert registry is not None
        access = read_access(path, keys_of_team.team.members, keys_of_team.program, lambda: registry)
        assert decode_access(encode_access(access)) == access
    except ProgramError as error:
        for finding in error.diagnostics:
            assert finding.render()
    except LfieldError as error:
        str(error)


def _certificates() -> list[bytes]:
    keys_of_team = team()
    return [
        certificate_in(pem).tbs_certificate_bytes
        for pem in (keys_of_team.host, keys_of_team.person, keys_of_team.authority)
    ]


def _lists() -> list[bytes]:
    from cryptography import x509

    return [x509.load_der_x509_crl(team().revoked).tbs_certlist_bytes]


def _names() -> list[bytes]:
    issuer = ((("commonName", fingerprint_in(team().authority)),),)
    times = {"notBefore": "Nov  3 20:00:00 2026 GMT", "notAfter": "Nov  3 20:00:00 2098 GMT"}
    uris = [uri_of("host", "bravo"), uri_of("person", "anna b/ö", Right)]
    plain = {"serialNumber": "1F", "issuer": issuer, **times}
    return [pack({**plain, "subjectAltName": [("URI", uri), ("DNS", "x")]}) for uri in uris]


def _handshakes() -> list[bytes]:
    near, far = _tls().channel(calls=True), _tls().channel(calls=False)
    hello = near.data_to_send()
    list(far.receive(hello))
    answer = far.data_to_send()
    list(near.receive(answer))
    return [b"\xff" + hello, b"\xff" + answer, b"\x02" + hello + near.data_to_send()]


def _pems() -> list[bytes]:
    keys_of_team = team()
    return [
        keys_of_team.host,
        keys_of_team.host_key,
        keys_of_team.host + b"\n" + keys_of_team.host_key,
        keys_of_team.authority,
    ]


_URIS = (
    "lfield://host/alpha",
    "lfield://person/anna?may=",
    "observe,stop",
    "%2f",
    "%ff",
    "?",
    "URI",
    "lfield:",
)
_YAML = (
    ": ",
    "\n",
    "  ",
    "- ",
    "{",
    "}",
    "[",
    "]",
    "all",
    "others",
    "tom",
    "Bell",
    "Lift",
    "stop",
    "command",
)

# -- orders as datagrams --------------------------------------------------------------------------------

ID, EPOCHS = bytes(range(16)), Epochs(b"hold hol", b"end end ")


@cache
def signers() -> tuple[OrderSigner, OrderSigner]:
    """A person and a host."""
    keys_of_team = team()
    person = Keys("person", keys_of_team.authority, keys_of_team.person, keys_of_team.person_key)
    return OrderSigner(person), OrderSigner(
        Keys("host", keys_of_team.authority, keys_of_team.host, keys_of_team.host_key)
    )


def decode_order_datagram(data: bytes) -> None:
    """Decode a datagram at a host, from another host, and at a desk; signed parts are signed again."""
    person, host = signers()
    known = CertificateCache(team().authority)
    known.add_der(person.certificate)
    admission = CertificateAdmission(
        Keys("host", team().authority, b"", b""), host.identity, TrustedClock(ManualClock(), NOT_BEFORE)
    )

    def check(checking: PendingCheck) -> None:
        try:
            datagrams.on_checked(checking, verify_order(checking.signed, checking.known, team().authority)[1])
        except LfieldError as error:
            datagrams.on_checked(checking, error)

    ports = OrderPorts(
        send=lambda sender, data: None,
        relay=lambda host, message: None,
        linked=lambda: ["alpha"],
        check=check,
        execute=lambda message, who, answer: answer(EmergencyStopResult({"p.fc": ""}, "", message.id)),
        later=lambda seconds, event: None,
    )
    datagrams = OrderReceiver(host, known, admission, lambda: EPOCHS, lambda: 0.0, ports)
    asking = OrderProtocol("stop", ID, "fog", {"bravo": Epochs()}, person, CertificateCache(team().authority))
    asking.start(0.0)
    for number, one in enumerate((data, signed_again(data))):
        datagrams.on_datagram(one, Sender("there", number))
        datagrams.on_relayed("alpha", RelayedOrder(one, 1))
        asking.on_datagram(one, 0.1)
        for send in asking.drain_effects():
            datagrams.on_datagram(send.datagram, Sender("here", 0))


def signed_again(data: bytes) -> bytes:
    """The datagram with valid signatures, if it can be parsed."""
    person, host = signers()
    try:
        read = decode_datagram(data)
        if isinstance(read, SignedOrder):
            return encode_datagram(replace(person.order(decode_order(read.order)), relay=read.relay))
        if isinstance(read, SignedAnswer):
            return encode_datagram(host.answer(decode_answer(read.answer), unknown=True))
    except LfieldError:
        pass
    return data


def _orders() -> list[bytes]:
    person, host = signers()
    asking = OrderProtocol(
        "lift", ID, "over", {"bravo": EPOCHS, "alpha": Epochs()}, person, CertificateCache(b"")
    )
    asking.start(0.0)
    answers = (
        EpochChallenge(ID, EPOCHS),
        order_confirmation(ID, EPOCHS, {"p.fc": "", "q.fc": "moves"}, "late"),
    )
    return [
        *(send.datagram for send in asking.drain_effects()),
        *(encode_datagram(host.answer(answer, unknown=True)) for answer in answers),
        encode_datagram(CertificateRequest("bravo", person.digest, EPOCHS)),
    ]


TARGETS = (
    Target(
        "certificate", _certificates, decode_certificate, tokens=(b"lfield://host/", b"\x30\x82", b"?may=")
    ),
    Target("revocations", _lists, decode_list, tokens=(b"\x30\x00", b"\x02\x01", b"\x17\x0d")),
    Target(
        "pem", _pems, decode_pem, tokens=(b"-----BEGIN CERTIFICATE-----\n", b"-----END PRIVATE KEY-----\n")
    ),
    Target("names", _names, decode_names, True, _URIS),
    Target(
        "signature", lambda: [signature_of_a_bundle(), b""], decode_signature, True, (der_of(team().host),)
    ),
    Target(
        "handshake", _handshakes, decode_handshake, tokens=(b"\x16\x03\x01", b"\x16\x03\x03", b"\x14\x03\x03")
    ),
    Target("access", lambda: [ACCESS.encode()], decode_access_file, tokens=_YAML),
    Target(
        "orders", _orders, decode_order_datagram, tokens=(MAGIC, ID, b"bravo", b"alpha", b"stop", b"pause")
    ),
)
