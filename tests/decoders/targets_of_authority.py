"""What proves who somebody is, and what they may: certificates, lists, signatures, handshakes, access files.

Certificates and lists are signed again after they were changed: what only a member of the team could send.
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

from lfield.authority.admission import Judged
from lfield.authority.believed import BelievedTime
from lfield.authority.identity import MAX_NAME, Right, identity_of, in_order, uri_of
from lfield.authority.judge import Revoked, judged
from lfield.authority.keys import Keys
from lfield.authority.making import new_authority
from lfield.authority.orders.signing import Certificates, Signer, verified_order
from lfield.authority.pem import certificate_in, private_in
from lfield.authority.reading import der_of, fingerprint_in, identity_in, identity_in_der, revoked_in
from lfield.authority.signature import sign, signed
from lfield.clock import ManualClock
from lfield.errors import KeysError, LfieldError, ProgramError, SignatureError
from lfield.host.stopping.datagrams import Checking, OrderDatagrams
from lfield.host.stopping.rations import Sender
from lfield.mission.access.access_file import read_access
from lfield.mission.access.rules import decode_access, encode_access
from lfield.net.tls import Tls
from lfield.operator.orders.asking import Asking
from lfield.wire.observing import EmergencyStopped
from lfield.wire.orders import (
    MAGIC,
    CertificateRequest,
    Challenge,
    Epochs,
    RelayedOrder,
    SignedAnswer,
    SignedOrder,
    confirmed,
    decode_answer,
    decode_datagram,
    decode_order,
    encode_datagram,
)

BEGIN, END = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2026, 2099))
#: Behind a text that was signed in DER: the name of Ed25519, and the length of its signature as bits.
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
    """An authority, and what it has made; keys and certificates are PEM, the list is DER."""

    authority: bytes
    key: bytes
    host: bytes
    host_key: bytes
    person: bytes
    person_key: bytes
    revoked: bytes


def _made() -> list[bytes]:
    authority = new_authority(BEGIN, END)
    host = authority.issue("host", "bravo", at=BEGIN, ends=END)
    person = authority.issue("person", "anna", may=[*Right], at=BEGIN, ends=END)
    revoked = authority.revocation_list(Revoked(3, frozenset({"1f", "a2"}), BEGIN))
    own = (authority.certificate, authority.key, host.certificate, host.key)
    return [*own, person.certificate, person.key, revoked]


@cache
def team() -> Made:
    """The authority of all inputs."""
    return Made(*fixed("authority", _made))


def signature_of_a_bundle() -> bytes:
    """What the person has signed: the same keys sign the same in the same way."""
    made = team()
    return sign(DIGEST, Keys("person", made.authority, made.person, made.person_key), BEGIN + 1.0)


@cache
def _signer() -> Ed25519PrivateKey:
    return private_in(team().key)


def resigned(body: bytes) -> bytes:
    """A signed thing in DER with this body, as the authority would have signed it."""
    parts = body + _ED25519 + _BITS + _signer().sign(body)
    length = len(parts).to_bytes((len(parts).bit_length() + 7) // 8 or 1, "big")
    return b"\x30" + (length if len(parts) < 128 else bytes([0x80 | len(length)]) + length) + parts


def take_certificate(data: bytes) -> None:
    """A certificate that the authority has signed, whatever it says; and the same bytes as they are."""
    for shown in (resigned(data), data):
        with suppress(KeysError):
            who = identity_in_der(shown, team().authority)
            judged(who, at=BEGIN + 1.0, authority=fingerprint_in(team().authority))
            assert len(who.name) <= MAX_NAME
            in_order(who.may)


def take_list(data: bytes) -> None:
    """A revocation list that the authority has signed; and the same bytes as they are."""
    for shown in (resigned(data), data):
        with suppress(KeysError):
            revoked_in(shown, team().authority)


def take_pem(data: bytes) -> None:
    """A file of a key folder: a certificate or a private key."""
    with suppress(KeysError):
        identity_in(data, team().authority)
    with suppress(KeysError):
        private_in(data)
    with suppress(KeysError):
        Tls(Keys("host", team().authority, data, data))


def take_names(data: bytes) -> None:
    """What OpenSSL says of a certificate."""
    with suppress(msgspec.MsgspecError, ValueError, RecursionError):
        tree = unpack(data)
        if isinstance(tree, dict):
            who = identity_of(tree)
            assert who.kind in ("stranger", "host", "person")
            str(who)


def take_signature(data: bytes) -> None:
    """The signature of a bundle."""
    with suppress(SignatureError):
        signed(DIGEST, data, team().authority)


def take_handshake(data: bytes) -> None:
    """Bytes of a stranger who calls, or is called, in pieces of a size that the first byte says."""
    for calls in (False, True):
        channel, size = _tls().channel(calls=calls), 1 + 4 * (data[0] if data else 0)
        with suppress(LfieldError):
            for at in range(1, len(data), size):
                list(channel.feed(data[at : at + size]))
        assert not channel.proven


@cache
def _tls() -> Tls:
    return Tls(Keys("host", team().authority, team().host, team().host_key))


def take_access(data: bytes) -> None:
    """An access file."""
    path, made = Path(gettempdir()) / "lfield-fuzz.access.yaml", mission()
    path.write_bytes(data)
    try:
        registry = made.registry
        assert registry is not None
        access = read_access(path, made.team.members, made.program, lambda: registry)
        assert decode_access(encode_access(access)) == access
    except ProgramError as error:
        for finding in error.diagnostics:
            assert finding.render()
    except LfieldError as error:
        str(error)


def _certificates() -> list[bytes]:
    made = team()
    return [certificate_in(pem).tbs_certificate_bytes for pem in (made.host, made.person, made.authority)]


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
    hello = near.take()
    list(far.feed(hello))
    answer = far.take()
    list(near.feed(answer))
    return [b"\xff" + hello, b"\xff" + answer, b"\x02" + hello + near.take()]


def _pems() -> list[bytes]:
    made = team()
    return [made.host, made.host_key, made.host + b"\n" + made.host_key, made.authority]


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
def signers() -> tuple[Signer, Signer]:
    """A person and a host."""
    made = team()
    person = Keys("person", made.authority, made.person, made.person_key)
    return Signer(person), Signer(Keys("host", made.authority, made.host, made.host_key))


def take_datagram(data: bytes) -> None:
    """At the port of a host, from another host, and at the port of a desk. A signed part is signed again."""
    person, host = signers()
    known = Certificates(team().authority)
    known.learn(person.certificate)
    admission = Judged(Keys("host", team().authority, b"", b""), host.who, BelievedTime(ManualClock(), BEGIN))
    datagrams = OrderDatagrams(host, known, admission, lambda: EPOCHS, lambda: 0.0)

    def check(checking: Checking) -> None:
        try:
            datagrams.checked(checking, verified_order(checking.signed, checking.known, team().authority)[1])
        except LfieldError as error:
            datagrams.checked(checking, error)

    datagrams.check = check
    datagrams.linked = lambda: ["alpha"]
    datagrams.execute = lambda message, who, answer: answer(EmergencyStopped({"p.fc": ""}, "", message.id))
    asking = Asking("stop", ID, "fog", {"bravo": Epochs()}, person, Certificates(team().authority))
    asking.start(0.0)
    for number, one in enumerate((data, signed_again(data))):
        datagrams.came(one, Sender("there", number))
        datagrams.relayed("alpha", RelayedOrder(one, 1))
        asking.heard(one, 0.1)
        for send in asking.take():
            datagrams.came(send.datagram, Sender("here", 0))


def signed_again(data: bytes) -> bytes:
    """The same with signatures that are good, where it can be read."""
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
    asking = Asking("lift", ID, "over", {"bravo": EPOCHS, "alpha": Epochs()}, person, Certificates(b""))
    asking.start(0.0)
    answers = (Challenge(ID, EPOCHS), confirmed(ID, EPOCHS, {"p.fc": "", "q.fc": "moves"}, "late"))
    return [
        *(send.datagram for send in asking.take()),
        *(encode_datagram(host.answer(answer, unknown=True)) for answer in answers),
        encode_datagram(CertificateRequest("bravo", person.digest, EPOCHS)),
    ]


TARGETS = (
    Target("certificate", _certificates, take_certificate, words=(b"lfield://host/", b"\x30\x82", b"?may=")),
    Target("revocations", _lists, take_list, words=(b"\x30\x00", b"\x02\x01", b"\x17\x0d")),
    Target("pem", _pems, take_pem, words=(b"-----BEGIN CERTIFICATE-----\n", b"-----END PRIVATE KEY-----\n")),
    Target("names", _names, take_names, True, _URIS),
    Target("signature", lambda: [signature_of_a_bundle(), b""], take_signature, True, (der_of(team().host),)),
    Target(
        "handshake", _handshakes, take_handshake, words=(b"\x16\x03\x01", b"\x16\x03\x03", b"\x14\x03\x03")
    ),
    Target("access", lambda: [ACCESS.encode()], take_access, words=_YAML),
    Target("orders", _orders, take_datagram, words=(MAGIC, ID, b"bravo", b"alpha", b"stop", b"pause")),
)
