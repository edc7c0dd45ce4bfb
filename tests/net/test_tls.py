"""TLS of one link without any socket: who is proven, who is not, and what both are told."""

import ssl
from contextlib import suppress
from dataclasses import replace

import pytest
from certificates import Shown, Team, made
from cryptography.hazmat.primitives import serialization
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import ALL, STRANGER, Right, uri_of
from lfield.authority.pem import certificate_in, private_in
from lfield.errors import GreetingError, KeysError, LfieldError, WireError
from lfield.net.tls import MAX_HANDSHAKE, Channel, Tls

TEAM, OTHER = Team(), Team()
ALPHA, BRAVO = TEAM.host("alpha"), TEAM.host("bravo")
CALLING, CALLED = Tls(ALPHA), Tls(BRAVO)


class Ends:
    """Two ends and what went between them; `told` is what each was told when it broke."""

    def __init__(self, calling: Tls, called: Tls) -> None:
        self.near, self.far = calling.channel(calls=True), called.channel(calls=False)
        self.heard: dict[Channel, bytes] = {self.near: b"", self.far: b""}
        self.told: dict[Channel, LfieldError] = {}
        self.sizes: list[int] = []
        self.settle()

    def settle(self) -> None:
        """Carry bytes to and fro until there are none."""
        moved = True
        while moved:
            moved = self.carry(self.near, self.far) | self.carry(self.far, self.near)

    def carry(self, source: Channel, target: Channel) -> bool:
        data = source.take()
        if data:
            self.give(target, data)
        return bool(data)

    def give(self, target: Channel, data: bytes) -> None:
        self.sizes.append(len(data))
        try:
            for piece in target.feed(data):
                self.heard[target] += piece
        except LfieldError as error:
            self.told.setdefault(target, error)


def test_both_know_who_the_other_is():
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    assert (ends.near.proven, ends.far.proven) == (True, True)
    assert (str(ends.near.who), str(ends.far.who)) == ("host bravo", "host alpha")
    assert ends.far.who.authority == TEAM.authority.fingerprint
    assert ends.told == {}


def test_a_person_is_known_with_rights():
    ends = Ends(Tls(TEAM.person("anna", Right.OBSERVE, Right.STOP)), Tls(BRAVO))
    assert (ends.far.who.kind, ends.far.who.name, sorted(ends.far.who.may)) == (
        "person",
        "anna",
        ["observe", "stop"],
    )


@pytest.mark.parametrize("size", [1, 100, 1 << 14, (1 << 14) + 1, 300_000])
def test_what_is_said_comes_whole_and_in_one_piece(size):
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    text = bytes(n % 251 for n in range(size))
    for source, target in ((ends.near, ends.far), (ends.far, ends.near)):
        sealed = source.seal(text)
        assert size < 64 or text[:64] not in sealed
        assert source.take() == b""
        ends.give(target, sealed)
        assert ends.heard[target] == text


def test_bytes_may_come_one_at_a_time():
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    for byte in ends.near.seal(b"hello") + ends.near.seal(b" again"):
        ends.give(ends.far, bytes([byte]))
    assert ends.heard[ends.far] == b"hello again"


def test_two_messages_may_come_in_one():
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    ends.give(ends.far, ends.near.seal(b"one") + ends.near.seal(b" two"))
    assert ends.heard[ends.far] == b"one two"


def test_times_are_for_others_to_judge():
    late = TEAM.host("late", begin=1577836800.0, end=1577923200.0)
    ends = Ends(Tls(late), Tls(TEAM.host("early", begin=3e9)))
    assert str(ends.far.who) == "host late"
    assert (ends.far.who.ends, ends.near.who.begins) == (1577923200.0, 3e9)


ITSELF = made("alpha", [uri_of("host", "alpha")])
SIGNER = Shown(certificate_in(BRAVO.certificate), private_in(BRAVO.key))
BY_A_HOST = made("alpha", [uri_of("host", "alpha")], signer=SIGNER)


@pytest.mark.parametrize(
    "keys",
    [replace(OTHER.host("alpha"), authority=ALPHA.authority), TEAM.with_(ITSELF), TEAM.with_(BY_A_HOST)],
    ids=["of another authority", "signed by itself", "signed by a host"],
)
def test_whoever_is_called_takes_no_certificate_of_others(keys):
    ends = Ends(Tls(keys), Tls(BRAVO))
    assert isinstance(ends.told[ends.far], GreetingError)
    assert "certificate is not" in str(ends.told[ends.far])
    assert not ends.far.proven
    assert ends.far.who == STRANGER
    assert "it does not take the certificate shown to it" in str(ends.told[ends.near])


def test_whoever_calls_says_nothing_to_a_host_of_another_authority():
    ends = Ends(Tls(ALPHA), Tls(OTHER.host("bravo")))
    assert "not signed by the authority of this team" in str(ends.told[ends.near])
    assert not ends.near.proven
    assert not ends.far.proven
    assert "it does not take the certificate shown to it" in str(ends.told[ends.far])


def test_a_certificate_that_names_nobody_proves_nothing():
    for uris in ([], [uri_of("host", "a"), uri_of("host", "b")], ["lfield://host/", "https://host/alpha"]):
        assert Ends(Tls(TEAM.odd(*uris)), Tls(BRAVO)).far.who == STRANGER


def test_whoever_shows_no_certificate_is_told_so():
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    ends.near = Channel(context, lambda certificate, who: None, calls=True)
    ends.far = Tls(BRAVO).channel(calls=False)
    ends.heard, ends.told = {ends.near: b"", ends.far: b""}, {}
    ends.settle()
    assert "it shows no certificate" in str(ends.told[ends.far])
    assert ends.heard[ends.near] == b""
    assert "it wants a certificate" in str(ends.told[ends.near])


def test_an_older_tls_is_refused():
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    ends.near, ends.far = (
        Channel(context, lambda certificate, who: None, calls=True),
        Tls(BRAVO).channel(calls=False),
    )
    ends.settle()
    assert "this is no TLS 1.3" in str(ends.told[ends.far])


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n\r\n", bytes(64), b"\xff", b"\x00\x00\x00\x05\x01"])
def test_what_is_no_tls_is_known_by_its_first_byte(data):
    channel = Tls(ALPHA).channel(calls=False)
    with pytest.raises(WireError, match="no lfield host, or one of an earlier version"):
        list(channel.feed(data))
    assert channel.take() == b""


def test_a_stranger_can_make_nobody_hold_more_than_a_handshake():
    channel = Tls(ALPHA).channel(calls=False)
    # A client's first message that promises 100,000 bytes, in records of 256.
    data = b"\x01\x01\x86\xa0" + bytes(100_000)
    records = [b"\x16\x03\x01\x01\x00" + data[at : at + 256] for at in range(0, len(data), 256)]
    fed = []
    with pytest.raises(WireError):
        fed.extend(list(channel.feed(record)) or record for record in records)
    assert sum(map(len, fed)) <= MAX_HANDSHAKE


@given(st.lists(st.binary(max_size=300), max_size=20), st.booleans())
def test_whatever_a_stranger_sends_is_a_sentence_and_no_word_of_ours(pieces, greets):
    """Behind a first word that is good, or the first byte of one."""
    channel = CALLED.channel(calls=False)
    first = CALLING.channel(calls=True).take() if greets else b"\x16"
    with suppress(WireError, GreetingError):
        for piece in (first, *pieces):
            assert list(channel.feed(piece)) == []
    assert not channel.proven
    assert channel.who == STRANGER


#: Of the last word of whoever calls: a record that means nothing, for old boxes on the way.
CHANGE_CIPHER = bytes.fromhex("140303000101")


@given(st.data())
def test_a_handshake_with_one_bit_bent_proves_nobody(data):
    near, far = CALLING.channel(calls=True), CALLED.channel(calls=False)
    list(far.feed(near.take()))
    list(near.feed(far.take()))
    last = bytearray(near.take())
    assert near.proven
    begin = 8 * len(CHANGE_CIPHER) if last.startswith(CHANGE_CIPHER) else 0
    bit = data.draw(st.integers(begin, 8 * len(last) - 1))
    last[bit // 8] ^= 1 << bit % 8
    with suppress(WireError, GreetingError):
        assert list(far.feed(bytes(last))) == []
    assert not far.proven


def test_a_bit_that_flips_on_the_way_is_seen():
    ends = Ends(Tls(ALPHA), Tls(BRAVO))
    sealed = bytearray(ends.near.seal(b"take off"))
    sealed[-1] ^= 1
    ends.give(ends.far, bytes(sealed))
    assert isinstance(ends.told[ends.far], WireError)
    assert "bent on the way" in str(ends.told[ends.far])
    assert ends.heard[ends.far] == b""


def test_what_was_recorded_of_one_link_is_nothing_on_another_nor_twice_on_the_same():
    first, second = (Ends(Tls(ALPHA), Tls(BRAVO)) for _ in range(2))
    sealed = first.near.seal(b"take off")
    second.give(second.far, sealed)
    assert isinstance(second.told[second.far], WireError)
    first.give(first.far, sealed)
    first.give(first.far, sealed)
    assert first.heard[first.far] == b"take off"
    assert isinstance(first.told[first.far], WireError)


def test_a_person_cannot_pass_for_a_host():
    ends = Ends(Tls(ALPHA), Tls(TEAM.person("anna", *ALL)))
    assert "its certificate is not good" in str(ends.told[ends.near])
    assert not ends.near.proven


def test_a_host_knows_itself_as_others_do():
    assert Tls(ALPHA).own() == Ends(Tls(ALPHA), Tls(BRAVO)).far.who
    for keys in (TEAM.person("anna", *ALL), replace(ALPHA, authority=OTHER.authority.certificate)):
        with pytest.raises(KeysError, match="these keys are no good for a host"):
            Tls(keys).own()


def test_keys_that_do_not_belong_together_are_told():
    encrypted = private_in(ALPHA.key).private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(b"secret"),
    )
    for key in (BRAVO.key, b"nothing", encrypted):
        with pytest.raises(KeysError, match="the keys are damaged, or do not belong together"):
            Tls(replace(ALPHA, key=key))
    with pytest.raises(KeysError, match="the keys are damaged"):
        Tls(replace(ALPHA, certificate=b"nothing"))
    with pytest.raises(KeysError, match="the keys are damaged"):
        Tls(replace(ALPHA, authority=b"\xff"))
