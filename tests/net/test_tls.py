"""TLS of one link without sockets: which peers are authenticated, which are refused, and the errors of
both."""

import ssl
from contextlib import suppress
from dataclasses import replace

import pytest
from certificates import CertificateWithKey, Team, made
from cryptography.hazmat.primitives import serialization
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import ALL_RIGHTS, ANONYMOUS, Right, uri_of
from lfield.authority.pem import certificate_in, private_in
from lfield.errors import HandshakeError, KeysError, LfieldError, WireError
from lfield.net.tls import MAX_HANDSHAKE, MAX_SESSIONS, TlsChannel, TlsIdentity

TEAM, OTHER = Team(), Team()
ALPHA, BRAVO = TEAM.host("alpha"), TEAM.host("bravo")
CALLING, CALLED = TlsIdentity(ALPHA), TlsIdentity(BRAVO)


class Ends:
    """Two ends and the bytes between them; `errors` is the error of each."""

    def __init__(self, calling: TlsIdentity, called: TlsIdentity, address: str = "") -> None:
        self.near, self.far = calling.channel(calls=True, address=address), called.channel(calls=False)
        self.received: dict[TlsChannel, bytes] = {self.near: b"", self.far: b""}
        self.errors: dict[TlsChannel, LfieldError] = {}
        self.sizes: list[int] = []
        self.settle()

    def settle(self) -> None:
        """Carry bytes in both directions until there are none."""
        moved = True
        while moved:
            moved = self.carry(self.near, self.far) | self.carry(self.far, self.near)

    def carry(self, source: TlsChannel, target: TlsChannel) -> bool:
        data = source.data_to_send()
        if data:
            self.give(target, data)
        return bool(data)

    def give(self, target: TlsChannel, data: bytes) -> None:
        self.sizes.append(len(data))
        try:
            for piece in target.receive(data):
                self.received[target] += piece
        except LfieldError as error:
            self.errors.setdefault(target, error)


def test_both_ends_know_the_authenticated_peer():
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    assert (ends.near.proven, ends.far.proven) == (True, True)
    assert (str(ends.near.identity), str(ends.far.identity)) == ("host bravo", "host alpha")
    assert ends.far.identity.authority == TEAM.authority.fingerprint
    assert ends.errors == {}


def test_a_person_is_authenticated_with_rights():
    ends = Ends(TlsIdentity(TEAM.person("anna", Right.OBSERVE, Right.STOP)), TlsIdentity(BRAVO))
    assert (ends.far.identity.kind, ends.far.identity.name, sorted(ends.far.identity.may)) == (
        "person",
        "anna",
        ["observe", "stop"],
    )


@pytest.mark.parametrize("size", [1, 100, 1 << 14, (1 << 14) + 1, 300_000])
def test_a_message_of_any_size_is_encrypted_and_received_whole(size):
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    text = bytes(n % 251 for n in range(size))
    for source, target in ((ends.near, ends.far), (ends.far, ends.near)):
        sealed = source.encrypt(text)
        assert size < 64 or text[:64] not in sealed
        assert source.data_to_send() == b""
        ends.give(target, sealed)
        assert ends.received[target] == text


def test_bytes_may_arrive_one_at_a_time():
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    for byte in ends.near.encrypt(b"hello") + ends.near.encrypt(b" again"):
        ends.give(ends.far, bytes([byte]))
    assert ends.received[ends.far] == b"hello again"


def test_two_messages_may_arrive_together():
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    ends.give(ends.far, ends.near.encrypt(b"one") + ends.near.encrypt(b" two"))
    assert ends.received[ends.far] == b"one two"


def test_the_channel_reports_the_validity_and_does_not_judge_it():
    late = TEAM.host("late", begin=1577836800.0, end=1577923200.0)
    ends = Ends(TlsIdentity(late), TlsIdentity(TEAM.host("early", begin=3e9)))
    assert str(ends.far.identity) == "host late"
    assert (ends.far.identity.valid_until, ends.near.identity.valid_from) == (1577923200.0, 3e9)


ITSELF = made("alpha", [uri_of("host", "alpha")])
SIGNER = CertificateWithKey(certificate_in(BRAVO.certificate), private_in(BRAVO.key))
BY_A_HOST = made("alpha", [uri_of("host", "alpha")], signer=SIGNER)


@pytest.mark.parametrize(
    "keys",
    [replace(OTHER.host("alpha"), authority=ALPHA.authority), TEAM.with_(ITSELF), TEAM.with_(BY_A_HOST)],
    ids=["by another authority", "self-signed", "signed by a host"],
)
def test_the_listening_end_refuses_foreign_certificates(keys):
    ends = Ends(TlsIdentity(keys), TlsIdentity(BRAVO))
    assert isinstance(ends.errors[ends.far], HandshakeError)
    assert "peer certificate rejected" in str(ends.errors[ends.far])
    assert not ends.far.proven
    assert ends.far.identity == ANONYMOUS
    assert "peer rejected the certificate of this host" in str(ends.errors[ends.near])


def test_the_dialling_end_refuses_a_host_of_another_authority():
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(OTHER.host("bravo")))
    assert "not signed by the CA of this team" in str(ends.errors[ends.near])
    assert not ends.near.proven
    assert not ends.far.proven
    assert "peer rejected the certificate of this host" in str(ends.errors[ends.far])


def test_a_certificate_without_one_valid_name_authenticates_no_peer():
    for uris in ([], [uri_of("host", "a"), uri_of("host", "b")], ["lfield://host/", "https://host/alpha"]):
        assert Ends(TlsIdentity(TEAM.unusual(*uris)), TlsIdentity(BRAVO)).far.identity == ANONYMOUS


class Dials:
    """Successive links between two processes, each closed regularly."""

    def __init__(self) -> None:
        self.known: list[tuple[bytes, str]] = []
        note = lambda certificate, who: self.known.append((certificate, str(who)))  # noqa: E731
        self.calling, self.called = TlsIdentity(ALPHA, note), TlsIdentity(BRAVO, note)

    def again(self, called: TlsIdentity | None = None) -> tuple[Ends, int]:
        ends = Ends(self.calling, called or self.called, "bravo:1")
        # The session ticket comes with the first bytes.
        ends.give(ends.near, ends.far.encrypt(b"hello"))
        size = sum(ends.sizes)
        ends.far.end()
        self.calling.keep_session("bravo:1", ends.near)
        return ends, size


def test_the_next_link_resumes_the_session_with_the_first_certificates():
    dials = Dials()
    first, full = dials.again()
    assert not first.near.is_resumed
    for _ in range(3):
        ends, size = dials.again()
        assert (ends.near.is_resumed, ends.far.is_resumed) == (True, True)
        assert (str(ends.near.identity), str(ends.far.identity)) == ("host bravo", "host alpha")
        assert size < 0.4 * full
    assert len(dials.known) == 8
    assert len(set(dials.known)) == 2


def test_a_session_is_resumed_only_by_the_process_that_has_it():
    dials = Dials()
    dials.again()
    ends, _ = dials.again(TlsIdentity(BRAVO))
    assert ends.near.proven
    assert not ends.near.is_resumed


def test_the_number_of_sessions_kept_is_bounded():
    dials = Dials()
    for number in range(MAX_SESSIONS + 10):
        ends = Ends(dials.calling, dials.called)
        ends.give(ends.near, ends.far.encrypt(b"hello"))
        ends.far.end()
        dials.calling.keep_session(f"bravo:{number}", ends.near)
    assert len(dials.calling._sessions) <= MAX_SESSIONS
    assert dials.called._called.session_stats()["number"] == MAX_SESSIONS
    dials.calling._sessions["bravo:1"] = dials.calling._sessions[f"bravo:{MAX_SESSIONS - 1}"]
    assert all(dials.again()[0].near.is_resumed for _ in range(3))


def test_a_peer_without_a_certificate_is_refused():
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    ends.near = TlsChannel(context, lambda certificate, who: None, calls=True)
    ends.far = TlsIdentity(BRAVO).channel(calls=False)
    ends.received, ends.errors = {ends.near: b"", ends.far: b""}, {}
    ends.settle()
    assert "peer sent no certificate" in str(ends.errors[ends.far])
    assert ends.received[ends.near] == b""
    assert "peer requires a certificate" in str(ends.errors[ends.near])


def test_an_older_tls_version_is_refused():
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    ends.near, ends.far = (
        TlsChannel(context, lambda certificate, who: None, calls=True),
        TlsIdentity(BRAVO).channel(calls=False),
    )
    ends.settle()
    assert "not TLS 1.3" in str(ends.errors[ends.far])


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n\r\n", bytes(64), b"\xff", b"\x00\x00\x00\x05\x01"])
def test_bytes_that_are_no_tls_are_detected_by_the_first_byte(data):
    channel = TlsIdentity(ALPHA).channel(calls=False)
    with pytest.raises(WireError, match="not an lfield host, or an outdated one"):
        list(channel.receive(data))
    assert channel.data_to_send() == b""


def test_an_unauthenticated_peer_cannot_fill_the_memory():
    channel = TlsIdentity(ALPHA).channel(calls=False)
    # A client's first message with a length of 100,000 bytes, in records of 256.
    data = b"\x01\x01\x86\xa0" + bytes(100_000)
    records = [b"\x16\x03\x01\x01\x00" + data[at : at + 256] for at in range(0, len(data), 256)]
    fed = []
    with pytest.raises(WireError):
        fed.extend(list(channel.receive(record)) or record for record in records)
    assert sum(map(len, fed)) <= MAX_HANDSHAKE


@given(st.lists(st.binary(max_size=300), max_size=20), st.booleans())
def test_any_bytes_of_an_unknown_peer_give_an_error_and_no_data(pieces, greets):
    """After a valid first message, or the first byte of one."""
    channel = CALLED.channel(calls=False)
    first = CALLING.channel(calls=True).data_to_send() if greets else b"\x16"
    with suppress(WireError, HandshakeError):
        for piece in (first, *pieces):
            assert list(channel.receive(piece)) == []
    assert not channel.proven
    assert channel.identity == ANONYMOUS


#: The dialling end sends this record for old middleboxes; it has no meaning.
CHANGE_CIPHER = bytes.fromhex("140303000101")


@given(st.data())
def test_a_handshake_with_one_changed_bit_authenticates_no_peer(data):
    near, far = CALLING.channel(calls=True), CALLED.channel(calls=False)
    list(far.receive(near.data_to_send()))
    list(near.receive(far.data_to_send()))
    last = bytearray(near.data_to_send())
    assert near.proven
    begin = 8 * len(CHANGE_CIPHER) if last.startswith(CHANGE_CIPHER) else 0
    bit = data.draw(st.integers(begin, 8 * len(last) - 1))
    last[bit // 8] ^= 1 << bit % 8
    with suppress(WireError, HandshakeError):
        assert list(far.receive(bytes(last))) == []
    assert not far.proven


def test_a_changed_bit_is_detected():
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO))
    sealed = bytearray(ends.near.encrypt(b"take off"))
    sealed[-1] ^= 1
    ends.give(ends.far, bytes(sealed))
    assert isinstance(ends.errors[ends.far], WireError)
    assert "corrupted in transit" in str(ends.errors[ends.far])
    assert ends.received[ends.far] == b""


def test_a_recorded_message_is_refused_on_another_link_and_on_repetition():
    first, second = (Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO)) for _ in range(2))
    sealed = first.near.encrypt(b"take off")
    second.give(second.far, sealed)
    assert isinstance(second.errors[second.far], WireError)
    first.give(first.far, sealed)
    first.give(first.far, sealed)
    assert first.received[first.far] == b"take off"
    assert isinstance(first.errors[first.far], WireError)


def test_a_person_certificate_is_refused_for_a_host():
    ends = Ends(TlsIdentity(ALPHA), TlsIdentity(TEAM.person("anna", *ALL_RIGHTS)))
    assert "peer certificate rejected" in str(ends.errors[ends.near])
    assert not ends.near.proven


def test_a_host_checks_its_own_certificate():
    assert TlsIdentity(ALPHA).own_identity() == Ends(TlsIdentity(ALPHA), TlsIdentity(BRAVO)).far.identity
    for keys in (TEAM.person("anna", *ALL_RIGHTS), replace(ALPHA, authority=OTHER.authority.certificate)):
        with pytest.raises(KeysError, match="keys rejected for a host"):
            TlsIdentity(keys).own_identity()


def test_mismatched_or_damaged_keys_are_reported():
    encrypted = private_in(ALPHA.key).private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(b"secret"),
    )
    for key in (BRAVO.key, b"nothing", encrypted):
        with pytest.raises(KeysError, match="the keys are damaged or mismatched"):
            TlsIdentity(replace(ALPHA, key=key))
    with pytest.raises(KeysError, match="the keys are damaged"):
        TlsIdentity(replace(ALPHA, certificate=b"nothing"))
    with pytest.raises(KeysError, match="the keys are damaged"):
        TlsIdentity(replace(ALPHA, authority=b"\xff"))
