"""The page by https at an address other than 127.0.0.1: access with and without keys. 127.0.0.2 serves as
such an address here; browsers have no exception for http there.
"""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import ssl
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from real_browser import Browser, believing, needs_browser

from lfield.authority.web_ca.browser_ca import BrowserCa, new_browser_ca
from lfield.authority.web_ca.web_keys import WebKeys, read_web_keys, write_web_keys
from lfield.errors import AddressError, KeysError
from lfield.net.connections import listener
from lfield.operator.web.page_sessions import (
    FOREIGN_ADDRESS,
    FOREIGN_PAGE,
    NO_SESSION,
    OLD_LINK,
    PageSessions,
)
from lfield.operator.web.page_site import addresses_of, network_site
from lfield.wire.fields import MAX_INPUT

ADDRESS, NAME, DAY = "127.0.0.2", "ground.local", 86400.0


@pytest.fixture(scope="module")
def root() -> BrowserCa:
    return new_browser_ca(time.time() - 60.0, time.time() + 9 * DAY)


@pytest.fixture(scope="module")
def folder(root: BrowserCa, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The keys of a page."""
    made = root.issue([ADDRESS, NAME], at=time.time() - 60.0, ends=time.time() + DAY)
    folder = tmp_path_factory.mktemp("keys") / "page"
    write_web_keys(folder, made.certificate, made.key)
    return folder


@pytest.fixture
def page(page_of, folder: Path):
    return page_of("--listen", ADDRESS, "--page-keys", folder)


class Client:
    """A browser's requests: it trusts one root."""

    def __init__(self, link: str, root: bytes) -> None:
        address = urlsplit(link)
        self.host, self.port, self.path = address.hostname or "", address.port or 0, f"/?{address.query}"
        self._context = ssl.create_default_context(cadata=root.decode())

    def asks(self, path: str, method: str = "GET", body: str = "", **headers: str) -> tuple[int, str, str]:
        """Status, text, and the received cookie."""
        connection = http.client.HTTPSConnection(self.host, self.port, context=self._context, timeout=60.0)
        try:
            connection.connect()
            assert connection.sock.version() == "TLSv1.3"
            connection.request(method, path, body or None, headers)
            answer = connection.getresponse()
            return answer.status, answer.read().decode(), answer.headers.get("set-cookie", "")
        finally:
            connection.close()


@pytest.fixture
def client(page, root: BrowserCa) -> Client:
    return Client(page.link, root.certificate)


@pytest.mark.few(0)
@pytest.mark.process
def test_the_link_opens_the_page_for_a_browser_with_the_root(page, client: Client) -> None:
    assert page.link.startswith(f"https://{ADDRESS}:")
    status, _, cookie = client.asks(client.path)
    assert status == 303
    name, _, rest = cookie.partition("=")
    assert name == f"__Host-lfield-{client.port}"
    assert {"Secure", "HttpOnly", "SameSite=Strict", "Path=/"} < set(rest.split("; "))
    session = cookie.partition(";")[0]
    assert client.asks("/snapshot", Cookie=session)[0] == 200
    # The certificate's other name is valid for the page too.
    assert client.asks("/snapshot", Cookie=session, Host=f"{NAME}:{client.port}")[0] == 200
    origin = f"https://{ADDRESS}:{client.port}"
    assert client.asks("/order", "POST", '{"action":"stop"}', Cookie=session, Origin=origin)[0] == 200
    assert page.line() != page.link
    assert page.line() == "pressed stop"
    for agent, text in (("", "x"), (7, "x"), ("lead", "x\ny\n"), ("lead", "x" * (MAX_INPUT + 1))):
        line = json.dumps({"host": "alpha", "agent": agent, "text": text})
        assert client.asks("/input", "POST", line, Cookie=session, Origin=origin)[0] == 400

    # A used link, no cookie, a foreign page, a foreign name, http as the page's own origin.
    assert client.asks(client.path)[:2] == (403, OLD_LINK)
    for path in ("/", "/snapshot", "/_nicegui/"):
        assert client.asks(path)[:2] == (403, NO_SESSION)
    for other in ("", "https://evil.example", f"http://{ADDRESS}:{client.port}"):
        headers = {"Cookie": session, **({"Origin": other} if other else {})}
        assert client.asks("/order", "POST", '{"action":"lift"}', **headers)[:2] == (403, FOREIGN_PAGE)
    for host in ("evil.example", f"localhost:{client.port}", f"127.0.0.1:{client.port}", ADDRESS):
        assert client.asks("/snapshot", Cookie=session, Host=host)[:2] == (403, FOREIGN_ADDRESS)


@pytest.mark.few(0)
@pytest.mark.process
def test_a_denied_order_is_refused_without_the_page_too(page, client: Client) -> None:
    page.do("bar stop your keys let you observe, not stop")
    own = client.asks(client.path)[2].partition(";")[0]
    # Malformed cookies of other programs on that address are sent too.
    cookie = f'a[]=b; x={{"a":1}}; theme=dark mode; alone; {own}; ümlaut="'
    page.line()
    origin = f"https://{ADDRESS}:{client.port}"
    response = client.asks("/order", "POST", '{"action":"stop"}', Cookie=cookie, Origin=origin)
    assert response[:2] == (403, "your keys let you observe, not stop")
    assert client.asks("/order", "POST", '{"action":"pause"}', Cookie=cookie, Origin=origin)[0] == 200
    assert page.line() == "pressed pause"


@pytest.mark.few(0)
@pytest.mark.process
def test_a_websocket_opens_beside_many_cookies_of_other_programs(page, client: Client) -> None:
    own = client.asks(client.path)[2].partition(";")[0]
    handshake = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Origin": f"https://{ADDRESS}:{client.port}",
        "Cookie": "; ".join([*(f"program{n}={'x' * 4000}" for n in range(10)), own]),
    }
    assert client.asks("/_nicegui_ws/socket.io/?EIO=4&transport=websocket", **handshake)[0] == 101


@pytest.mark.few(0)
@pytest.mark.process
def test_requests_without_tls_or_with_another_root_get_no_answer(page, client: Client) -> None:
    with socket.create_connection((client.host, client.port), 60.0) as plain:
        plain.sendall(f"GET {client.path} HTTP/1.1\r\nHost: {ADDRESS}:{client.port}\r\n\r\n".encode())
        assert b"HTTP" not in b"".join(iter(lambda: plain.recv(1 << 12), b""))
    with pytest.raises(ssl.SSLCertVerificationError):
        Client(page.link, new_browser_ca(time.time() - 60.0, time.time() + DAY).certificate).asks("/")
    old = ssl.create_default_context()
    old.check_hostname, old.verify_mode, old.maximum_version = (
        False,
        ssl.CERT_NONE,
        ssl.TLSVersion.TLSv1_2,
    )
    with socket.create_connection((client.host, client.port), 60.0) as sock, pytest.raises(ssl.SSLError):
        old.wrap_socket(sock)
    # The link is still valid.
    assert client.asks(client.path)[0] == 303


@pytest.mark.process
@needs_browser
@pytest.mark.browser
def test_a_browser_opens_the_page_and_presses_stop(page_of, folder: Path) -> None:
    page = page_of("--listen", ADDRESS, "--page-keys", folder)
    browser = Browser(*believing(folder), f"--proxy-bypass-list={ADDRESS}")
    try:
        browser.open(page.link)
        assert browser.driver.current_url == f"{page.address}/"
        cookies = browser.driver.get_cookies()
        assert [(c["name"][:7], c["secure"], c["httpOnly"], c["sameSite"]) for c in cookies] == [
            ("__Host-", True, True, "Strict")
        ]
        page.line()
        browser.thing("stop").click()
        assert page.line() == "pressed stop"
        browser.says("confirmed-lead.fc", "safe")
        assert browser.asked_hosts() == {page.address.removeprefix("https://")}
        assert browser.errors == []
    finally:
        browser.close()


# --- sites ---------------------------------------------------------------------------------------


@pytest.fixture
def keys(folder: Path) -> WebKeys:
    return read_web_keys(folder)


async def test_a_site_has_the_names_of_its_certificate(keys: WebKeys) -> None:
    site = await network_site(ADDRESS, 0, keys, print)
    port = site.port
    assert site.addresses == [f"{ADDRESS}:{port}", f"{NAME}:{port}"]
    assert site.link("t") == f"https://{ADDRESS}:{port}/?token=t"
    site.close()


class Echo(asyncio.Protocol):
    """Sends back what it receives."""

    def connection_made(self, transport) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(data)


async def answers(address: str, port: int, root: BrowserCa) -> bool:
    """Return true if a browser that trusts this root reaches the page at an address."""
    context = ssl.create_default_context(cadata=root.certificate.decode())
    try:
        reader, writer = await asyncio.open_connection(address, port, ssl=context, server_hostname=NAME)
    except OSError:
        return False
    writer.write(b"?")
    answered = await reader.readexactly(1) == b"?"
    writer.close()
    return answered


async def test_the_page_is_served_at_the_current_addresses_of_its_name(
    keys: WebKeys, root: BrowserCa, monkeypatch
) -> None:
    """The rule holds for both address families, and before an address of the name exists."""
    leads, real = ["192.0.2.1", "127.0.0.2", "10.99.99.99"], socket.getaddrinfo

    def found(host, port, *arguments, flags=0, **more):
        hosts = leads if host == NAME and not flags & socket.AI_NUMERICHOST else [host]
        return [row for host in hosts for row in real(host, port, *arguments, flags=flags, **more)]

    monkeypatch.setattr(socket, "getaddrinfo", found)
    monkeypatch.setattr(listener, "CHECK_EVERY", 0.01)

    notes: list[str] = []
    site = await network_site(NAME, 0, keys, notes.append)
    site.limiter.start(Echo)
    assert await answers("127.0.0.2", site.port, root)
    leads[:] = ["192.0.2.1", "::1"]
    async with asyncio.timeout(30.0):
        while not await answers("::1", site.port, root) or await answers("127.0.0.2", site.port, root):
            await asyncio.sleep(0.01)
    assert f"{NAME} listening on [::1]:{site.port} too: the name now resolves to it" in notes
    assert any("not listening on 192.0.2.1:" in note and "'ip address' lists" in note for note in notes)
    site.close()
    await asyncio.sleep(0)
    assert not await answers("::1", site.port, root)


@pytest.mark.parametrize(
    ("port", "scheme", "addresses"),
    [
        (8470, "https", ["10.0.0.1:8470", "[fd00::2]:8470"]),
        (443, "https", ["10.0.0.1", "[fd00::2]"]),
        (80, "https", ["10.0.0.1:80", "[fd00::2]:80"]),
        (80, "http", ["10.0.0.1", "[fd00::2]"]),
    ],
)
def test_the_default_port_is_left_out_of_addresses(port: int, scheme: str, addresses: list[str]) -> None:
    assert addresses_of(("10.0.0.1", "fd00::2"), port, scheme) == addresses
    assert PageSessions(addresses, str, scheme).secure is (scheme == "https")


def site_at(name: str, keys: WebKeys) -> None:
    asyncio.run(network_site(name, 0, keys, print))


def unknown(*arguments: object, **more: object) -> list[object]:
    raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")


def test_an_address_that_is_not_of_this_computer_is_reported(keys: WebKeys, monkeypatch) -> None:
    with pytest.raises(AddressError, match="not an address of this computer"):
        site_at("10.99.99.99", keys)
    for address in ("fe80::1", "fe80::1%eth0"):
        with pytest.raises(AddressError, match="browsers do not open link-local IPv6 addresses"):
            site_at(address, keys)
    with pytest.raises(AddressError, match="which other computers cannot reach; give the address"):
        site_at("localhost", keys)
    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(AddressError, match="unknown host name"):
        site_at(NAME, keys)


def test_keys_that_openssl_cannot_use_are_reported(keys: WebKeys) -> None:
    broken = WebKeys(keys.names, keys.valid_from, keys.valid_until, keys.certificate, b"")
    with pytest.raises(KeysError, match="the keys of the page cannot be used"):
        site_at(ADDRESS, broken)
