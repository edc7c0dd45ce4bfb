"""Keys of web pages: browsers trust them for their names, and hosts refuse them on links between hosts."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lfield.authority.certificate_authority import IssuedCertificate, new_authority
from lfield.authority.key_material import Keys
from lfield.authority.peer_verification import NO_CHECK_TIME
from lfield.authority.web_ca import browser_ca
from lfield.authority.web_ca.browser_ca import BrowserCa, new_browser_ca, read_browser_ca
from lfield.authority.web_ca.web_keys import parse_web_keys, read_web_keys, write_web_keys
from lfield.authority.web_ca.web_names import is_match, is_private_name, normalised
from lfield.errors import HandshakeError, KeysError
from lfield.net.tls import TlsIdentity, as_file

AT, DAY = 1_795_464_000.0, 86400.0
NAMES = ("192.168.1.20", "ground.local")


@pytest.fixture(scope="module")
def root() -> BrowserCa:
    return new_browser_ca(AT, AT + 3650 * DAY)


@pytest.fixture(scope="module")
def page(root: BrowserCa) -> IssuedCertificate:
    return root.issue(NAMES, at=AT, ends=AT + 365 * DAY)


def opened(root: bytes, page: IssuedCertificate, name: str) -> str:
    """The TLS version of the connection of a browser that trusts `root` to the page. Raises ssl.SSLError."""
    browser, server = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    # The tests use their own times; OpenSSL would use the computer's clock.
    browser.verify_flags |= ssl.VerifyFlags(NO_CHECK_TIME)
    browser.load_verify_locations(cadata=root.decode())
    with as_file(page.certificate) as certificate, as_file(page.key) as key:
        server.load_cert_chain(certificate, key)
    to_server, to_browser = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = browser.wrap_bio(to_browser, to_server, server_hostname=name)
    served = server.wrap_bio(to_server, to_browser, server_side=True)
    for _ in range(2):
        for end in (client, served):
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
    return client.version() or ""


@pytest.mark.parametrize("name", NAMES)
def test_browser_that_trusts_the_root_opens_the_page_by_each_name(
    root: BrowserCa, page: IssuedCertificate, name: str
) -> None:
    assert opened(root.certificate, page, name) == "TLSv1.3"


def test_browser_refuses_an_untrusted_root_and_another_name(root: BrowserCa, page: IssuedCertificate) -> None:
    other_root = new_browser_ca(AT, AT + DAY)
    with pytest.raises(ssl.SSLCertVerificationError, match=r"self.signed|unable to get local issuer"):
        opened(other_root.certificate, page, NAMES[0])
    with pytest.raises(ssl.SSLCertVerificationError, match="mismatch"):
        opened(root.certificate, page, "192.168.1.21")


@pytest.mark.parametrize("name", ["bank.example", "notlocal", "8.8.8.8", "2001:db8::1"])
def test_stolen_root_cannot_sign_for_public_names(
    root: BrowserCa, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(KeysError, match="is in no private network"):
        root.issue([name], at=AT, ends=AT + DAY)
    # The holder of a stolen root would skip this check, but browsers check the name constraints of the root.
    monkeypatch.setattr(browser_ca, "is_private_name", lambda name: True)
    forged = root.issue([name], at=AT, ends=AT + DAY)
    with pytest.raises(ssl.SSLCertVerificationError, match="permitted subtree violation"):
        opened(root.certificate, forged, name)


def test_page_certificate_expires_with_the_root(root: BrowserCa) -> None:
    short = new_browser_ca(AT, AT + DAY)
    keys = short.issue(NAMES, at=AT, ends=AT + 365 * DAY)
    assert parse_web_keys(keys.certificate, keys.key).valid_until == AT + DAY
    with pytest.raises(KeysError, match=r"expired 2026-.*: remove browsers.crt and browsers.key"):
        short.issue(NAMES, at=AT + DAY, ends=AT + 2 * DAY)


def test_root_is_read_back(root: BrowserCa, page: IssuedCertificate) -> None:
    again = read_browser_ca(root.certificate, root.key)
    assert opened(root.certificate, again.issue(NAMES, at=AT, ends=AT + DAY), NAMES[0])
    for certificate, key in ((root.certificate, page.key), (page.certificate, root.key)):
        with pytest.raises(KeysError, match="of one copy"):
            read_browser_ca(certificate, key)


# --- on links between hosts --------------------------------------------------------------------------------


def handshake(client: TlsIdentity, server: TlsIdentity) -> None:
    """A TLS handshake between two identities. Raises HandshakeError."""
    calling, called = client.channel(calls=True), server.channel(calls=False)
    for _ in range(3):
        list(called.receive(calling.data_to_send()))
        list(calling.receive(called.data_to_send()))


def links(root: BrowserCa, page: IssuedCertificate) -> Iterator[tuple[TlsIdentity, TlsIdentity]]:
    """Pairs of client and server: a host, and page keys that trust the authority of the team."""
    team = new_authority(AT, AT + DAY)
    alpha = team.issue("host", "alpha", at=AT, ends=AT + DAY)
    host = TlsIdentity(Keys("host", team.certificate, alpha.certificate, alpha.key))
    handshake(host, host)
    for pem, key in ((page.certificate, page.key), (root.certificate, root.key)):
        intruder = TlsIdentity(Keys("host", team.certificate, pem, key))
        yield intruder, host
        yield host, intruder


def test_page_keys_and_root_are_refused_on_host_links(root: BrowserCa, page: IssuedCertificate) -> None:
    tried = 0
    for client, server in links(root, page):
        with pytest.raises(HandshakeError, match=r"peer certificate rejected"):
            handshake(client, server)
        tried += 1
    assert tried == 4


# --- names -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("192.168.1.20", "192.168.1.20"),
        ("[FD00:0::2]", "fd00::2"),
        ("Ground.LOCAL", "ground.local"),
        ("ground-2", "ground-2"),
    ],
)
def test_name_is_normalised(text: str, name: str) -> None:
    assert normalised(text) == name


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0.0.0.0",
        "::",
        "224.0.0.1",
        "fe80::1%eth0",
        "192.168.1",
        "192.168.1.256",
        "a b",
        "grün.local",
        "a_b",
        "*.local",
        "-a.local",
        "a..local",
        "local.",
        "https://a.local",
        "a.local:80",
        "../x",
        "a" * 64,
        "[a]",
    ],
)
def test_invalid_page_name_is_refused(text: str) -> None:
    with pytest.raises(KeysError, match=r"such as 192\.168\.1\.20"):
        normalised(text)


@given(st.text(max_size=30))
@example("1" * 5000)
def test_normalised_name_is_stable_or_refused(text: str) -> None:
    try:
        name = normalised(text)
    except KeysError:
        return
    assert normalised(name) == name


@pytest.mark.parametrize(
    ("name", "is_private"),
    [
        ("10.1.2.3", True),
        ("fd12::1", True),
        ("x.local", True),
        ("x.home.arpa", True),
        ("127.0.0.2", True),
        ("172.32.0.1", False),
        ("local", False),
        ("xlocal", False),
        ("x.local.example", False),
        ("::", False),
    ],
)
def test_private_names_are_recognised(name: str, is_private: bool) -> None:
    assert is_private_name(name) is is_private


@pytest.mark.parametrize(
    ("pattern", "name", "is_matching"),
    [
        ("a.example", "a.example", True),
        ("*.example", "a.example", True),
        ("*.example", "b.a.example", False),
        ("*.example", "example", False),
        ("*.", "a", False),
        ("*.0.0.2", "127.0.0.2", False),
    ],
)
def test_wildcard_matches_one_label(pattern: str, name: str, is_matching: bool) -> None:
    assert is_match(pattern, name) is is_matching


# --- the folder of page keys -------------------------------------------------------------------------------


def test_page_keys_report_names_and_validity(page: IssuedCertificate, tmp_path: Path) -> None:
    write_web_keys(tmp_path / "page", page.certificate, page.key)
    keys = read_web_keys(tmp_path / "page")
    assert keys.names == NAMES
    assert "PRIVATE" not in repr(keys)
    assert [keys.refusal(name, AT) for name in NAMES] == ["", ""]
    assert keys.refusal("10.0.0.1", AT) == (
        "the page's certificate is for 192.168.1.20 and ground.local, not for 10.0.0.1: 'lfield keys page "
        "10.0.0.1' makes one"
    )
    assert "ended 2027-" in keys.refusal(NAMES[0], AT + 365 * DAY)
    assert "set the clock" in keys.refusal(NAMES[0], 0.0)


def test_page_key_readable_by_others_is_refused(page: IssuedCertificate, tmp_path: Path) -> None:
    write_web_keys(tmp_path / "page", page.certificate, page.key)
    (tmp_path / "page" / "page.key").chmod(0o640)
    with pytest.raises(KeysError, match=r"run 'chmod 600 .*page\.key'"):
        read_web_keys(tmp_path / "page")


def test_invalid_page_keys_are_refused_with_a_reason(
    root: BrowserCa, page: IssuedCertificate, tmp_path: Path
) -> None:
    with pytest.raises(KeysError, match="'lfield keys page ADDRESS' makes some"):
        read_web_keys(tmp_path)
    other = root.issue(NAMES, at=AT, ends=AT + DAY)
    host = new_authority(AT, AT + DAY).issue("host", "alpha", at=AT, ends=AT + DAY)
    for certificate, key, text in (
        (page.certificate, other.key, "is not the key of the first certificate"),
        (page.certificate, b"", "page.key is empty: it was cut short"),
        (page.certificate, page.key[:30], "page.key is not a private key"),
        (b"", page.key, "page.crt is empty: it was cut short"),
        (page.certificate[:300], page.key, "page.crt is not a certificate"),
        (root.certificate, root.key, "with names of servers"),
        (host.certificate, host.key, "browsers take keys of RSA"),
    ):
        write_web_keys(tmp_path / "page", certificate, key)
        with pytest.raises(KeysError, match=text):
            read_web_keys(tmp_path / "page")


def test_chain_is_kept_and_its_first_certificate_is_checked(root: BrowserCa, page: IssuedCertificate) -> None:
    keys = parse_web_keys(page.certificate + root.certificate, page.key)
    assert (keys.names, keys.certificate) == (NAMES, page.certificate + root.certificate)
