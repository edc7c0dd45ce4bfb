"""Inventory files: their content, and the code and position of each error."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.errors import AddressError, InputFileError, ProgramError
from lfield.inventory.inventory import Inventory, InventoryHost
from lfield.inventory.inventory_file import normal_address, read_inventory
from lfield.inventory.location import find_inventory
from lfield.net.zenoh.config import NETWORK, decode_config

FULL = """\
hosts:
  alpha:
    addresses: [10.42.0.11, "[fd00::11]:8181", "fe80::1%wlan0", Alpha.local]
    user: pi
    ssh_port: 2222
    ssh_host: alpha.local
    arch: aarch64
    python: "3.11"
    service_port: 9182
    groups: [dialout, gpio]
    devices: alpha.devices.yaml
    options: [--sim, --lost-after=600]
  bravo: {addresses: ["127.0.0.1:18181"]}
"""


def read(folder: Path, text: str | bytes) -> Inventory:
    file = folder / "inventory.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_inventory(file)


def findings(folder: Path, text: str | bytes) -> list[tuple[str, int, int]]:
    """Code, line and column of each error of a file."""
    with pytest.raises(ProgramError) as error:
        read(folder, text)
    return [(each.code, each.span.line, each.span.column) for each in error.value.diagnostics]


def test_complete_inventory_is_read(tmp_path: Path) -> None:
    found = read(tmp_path, FULL)
    assert list(found.hosts) == ["alpha", "bravo"]
    alpha, bravo = found.hosts.values()
    addresses = ("10.42.0.11:8181", "[fd00::11]:8181", "[fe80::1%wlan0]:8181", "alpha.local:8181")
    assert alpha == InventoryHost(
        "alpha", addresses, "pi", 2222, "alpha.local", "aarch64", "3.11", 9182, ("dialout", "gpio"),
        tmp_path / "alpha.devices.yaml", (), ("--sim", "--lost-after=600"),
    )  # fmt: skip
    assert alpha.address == ",".join(addresses)
    assert alpha.service_addresses == (
        "10.42.0.11:9182", "[fd00::11]:9182", "[fe80::1%wlan0]:9182", "alpha.local:9182",
    )  # fmt: skip
    assert alpha.ssh_hosts == ("alpha.local",)
    assert bravo == InventoryHost("bravo", ("127.0.0.1:18181",))
    assert (bravo.service_address, bravo.ssh_hosts) == ("127.0.0.1:8182", ("127.0.0.1",))


def test_addresses_with_one_host_and_several_ports_have_one_service(tmp_path: Path) -> None:
    found = read(tmp_path, 'hosts: {alpha: {addresses: ["10.0.0.1:1", "10.0.0.1:2"]}}').hosts["alpha"]
    assert found.service_addresses == ("10.0.0.1:8182",)
    assert found.ssh_hosts == ("10.0.0.1",)


@pytest.mark.parametrize(
    ("text", "normal"),
    [
        ("10.0.0.1", "10.0.0.1:8181"),
        ("10.0.0.1:9", "10.0.0.1:9"),
        ("Alpha.Local", "alpha.local:8181"),
        ("alpha:65535", "alpha:65535"),
        ("FD00:0:0::11", "[fd00::11]:8181"),
        ("[FD00::11]", "[fd00::11]:8181"),
        ("[fd00::11]:9", "[fd00::11]:9"),
        ("fe80::1%wlan0", "[fe80::1%wlan0]:8181"),
        ("[FE80::1%Wlan0]:9", "[fe80::1%Wlan0]:9"),
        ("::1", "[::1]:8181"),
    ],
)
def test_address_is_normalised(text: str, normal: str) -> None:
    assert normal_address(text) == normal
    assert normal_address(normal) == normal


@pytest.mark.parametrize(
    "text",
    [
        "", ":8181", "10.0.0", "10.0.0.256", "010.0.0.1", "10.0.0.1:0", "10.0.0.1:65536", "10.0.0.1:",
        "10.0.0.1:x", "0.0.0.0", "::", "224.0.0.1", "ff02::1%eth0", "fe80::1", "fd00::1%eth0", "[fd00::1",
        "[fd00::1]8181", "fd00:::1", "[fe80::1%]", "al pha", "-alpha", "alpha.", "alpha/24", "a:1,b:2", "ä",
    ],
)  # fmt: skip
def test_invalid_address_is_reported(tmp_path: Path, text: str) -> None:
    with pytest.raises(AddressError):
        normal_address(text)
    assert findings(tmp_path, f"hosts:\n  alpha:\n    addresses: [\n      '{text}']\n") == [("Y113", 4, 7)]


A, B = "hosts:\n  alpha: {addresses: ['10.0.0.1:1']", "}\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", [("Y110", 1, 1)]),
        ("# nothing\n", [("Y110", 1, 1)]),
        ("hosts:\n", [("Y110", 1, 7)]),
        ("hosts: {}\n", [("Y110", 1, 8)]),
        ("- alpha\n", [("Y112", 1, 1), ("Y110", 1, 1)]),
        ("hosts: [alpha]\n", [("Y112", 1, 8), ("Y110", 1, 8)]),
        ("hosts:\n  alpha: 10.0.0.1\n", [("Y112", 2, 10), ("Y110", 2, 10)]),
        ("hosts:\n  alpha:\n    user: pi\n", [("Y110", 3, 5)]),
        ("hosts:\n  alpha: {addresses: []}\n", [("Y110", 2, 10)]),
        ("hosts:\n  alpha: {addresses: 10.0.0.1}\n", [("Y112", 2, 22)]),
        ("hosts:\n  alpha: {addresses: [1]}\n", [("Y112", 2, 23)]),
        ("hosts:\n  alpha: {addresses: [[a]]}\n", [("Y112", 2, 23)]),
        ("hosts: {alpha: {addresses: [a]}, \n  alpha: {addresses: [b]}}\n", [("Y105", 2, 3)]),
        ("hosts: {alpha: {addresses: [a]}, \n  Alpha: {addresses: [b]}}\n", [("Y113", 2, 3)]),
        ("hosts: {\n  'al pha': {addresses: [a]}}\n", [("Y113", 2, 3)]),
        ("hosts: {\n  -alpha: {addresses: [a]}}\n", [("Y113", 2, 3)]),
        ("hosts: {a: {addresses: [x]},\n  b: {addresses: [X]}}\n", [("Y113", 2, 19)]),
        ("hosts: {a: {addresses: [fd00::1]},\n  b: {addresses: ['[FD00:0::1]:8181']}}\n", [("Y113", 2, 19)]),
        ("hosts: {a: {addresses: ['x:1']},\n  b: {addresses: ['x:2']}}\n", [("Y113", 2, 19)]),
        ("hosts: {a: {addresses: [x]},\n  b: {addresses: ['x:8182'], service_port: 2}}\n", [("Y113", 2, 19)]),
        ("hosts:\n  alpha: {addresses: ['x:8182']}\n", [("Y113", 2, 23)]),
        ("hosts:\n  alpha: {addresses: [x, X]}\n", [("Y113", 2, 26)]),
        (f"{A}, user: 'a b'{B}", [("Y113", 2, 44)]),
        (f"{A}, user: -l{B}", [("Y113", 2, 44)]),
        (f"{A}, ssh_port: 0{B}", [("Y113", 2, 48)]),
        (f"{A}, ssh_port: x{B}", [("Y112", 2, 48)]),
        (f"{A}, ssh_host: -oProxyCommand{B}", [("Y113", 2, 48)]),
        (f"{A}, arch: arm64{B}", [("Y113", 2, 44)]),
        (f"{A}, python: 3.11{B}", [("Y112", 2, 46)]),
        (f"{A}, python: '2.7'{B}", [("Y113", 2, 46)]),
        (f"{A}, service_port: 65536{B}", [("Y113", 2, 52)]),
        (f"{A}, service_port: true{B}", [("Y112", 2, 52)]),
        (f"{A}, groups: [1]{B}", [("Y112", 2, 47)]),
        (f"{A}, options: --sim{B}", [("Y112", 2, 47)]),
        (f"{A}, options: [sim]{B}", [("Y113", 2, 47)]),
        (f"{A}, groups: ['a b']{B}", [("Y113", 2, 46)]),
        (f"{A}, devices: [x]{B}", [("Y112", 2, 47)]),
        (f"{A}, adresses: [b]{B}", [("Y111", 2, 38)]),
        ("hosts: {a: {addresses: [x]}}\nhost: {}\n", [("Y111", 2, 1)]),
        ("hosts: {a: {addresses: [x]}\n", [("Y101", 2, 1)]),
        ("hosts:\n\ta: {}\n", [("Y101", 2, 1)]),
        (b"hosts: \xff\n", [("Y109", 1, 8)]),
        ("a: &x 1\n", [("Y103", 1, 4)]),
        # All errors at once.
        (
            "hosts:\n  a: {addresses: [':1']}\n  b: {users: x}\n",
            [("Y113", 2, 19), ("Y110", 3, 6), ("Y111", 3, 7)],
        ),
    ],
)  # fmt: skip
def test_inventory_errors_have_code_and_position(
    tmp_path: Path, text: str | bytes, expected: list[tuple[str, int, int]]
) -> None:
    assert findings(tmp_path, text) == expected


def test_unreadable_inventory_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputFileError):
        read_inventory(tmp_path / "none.yaml")
    with pytest.raises(InputFileError):
        read_inventory(tmp_path)


def test_inventory_search_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    own, other, named = (tmp_path / name for name in ("config/lfield/inventory.yaml", "b.yaml", "c.yaml"))
    own.parent.mkdir(parents=True)
    monkeypatch.setattr("lfield.inventory.location.SYSTEM", tmp_path / "system.yaml")

    def found(path: Path | None = None, **environment: str) -> str | None:
        inventory = find_inventory(path, environment)
        return inventory and inventory.path.name

    assert found() is None
    for file in (tmp_path / "system.yaml", own, other, named):
        file.write_text("hosts: {alpha: {addresses: [alpha]}}\n")
    assert found() == "inventory.yaml"
    own.unlink()
    assert found() == "system.yaml"
    assert found(LFIELD_INVENTORY=str(other)) == "b.yaml"
    assert found(named, LFIELD_INVENTORY=str(other)) == "c.yaml"
    assert found(LFIELD_INVENTORY="") is None
    assert found(named, LFIELD_INVENTORY="") == "c.yaml"
    with pytest.raises(InputFileError):
        found(LFIELD_INVENTORY=str(own))


# Zenoh

FABRIC = """\
zenoh:
  connect: [tcp/192.0.2.10:7447]
  settings: {transport/link/tls/root_ca_certificate: ca.pem, transport/link/tx/lease: 5000}
hosts:
  alpha: {addresses: ["zenoh:alpha", 10.42.0.11]}
  bravo: {addresses: ["zenoh:bravo:9000"], zenoh: {listen: [tcp/0.0.0.0:7447], gossip: true}}
"""


def test_zenoh_hosts_and_settings_are_read(tmp_path: Path) -> None:
    found = read(tmp_path, FABRIC)
    alpha, bravo = found.hosts.values()
    assert found.zenoh is not None
    assert (found.zenoh.mode, found.zenoh.connect) == ("client", ("tcp/192.0.2.10:7447",))
    options = found.zenoh.options()
    assert options["transport/link/tls/root_ca_certificate"] == '"ca.pem"'
    assert (options["transport/link/tx/lease"], options["scouting/multicast/enabled"]) == ("5000", "false")
    assert options["scouting/gossip/enabled"] == "false"
    assert decode_config(found.zenoh.encode()) == found.zenoh
    assert alpha.address == "zenoh:alpha:8181,10.42.0.11:8181"
    assert alpha.service_address == "zenoh:alpha:8182,10.42.0.11:8182"
    assert (alpha.ssh_hosts, bravo.ssh_hosts) == (("10.42.0.11",), ("bravo",))
    assert bravo.zenoh is not None
    assert (bravo.zenoh.mode, bravo.zenoh.gossip, bravo.zenoh.multicast) == ("peer", True, False)
    assert found.own_sections == {"bravo": bravo.zenoh}


def test_host_uses_its_own_zenoh_section(tmp_path: Path) -> None:
    file = tmp_path / "inventory.yaml"
    file.write_text(FABRIC)
    found = find_inventory(file, {})
    assert found is not None
    assert found.zenoh == NETWORK.config
    NETWORK.select("bravo")
    assert found.hosts["bravo"].zenoh == NETWORK.config
    NETWORK.select("alpha", found.zenoh.encode())
    assert found.zenoh == NETWORK.config
    NETWORK.configure(None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('hosts:\n  a: {addresses: ["zenoh:a"]}\n', [("Y110", 2, 3)]),
        ("zenoh: {}\nhosts: {a: {addresses: [10.0.0.1]}}\n", [("Y110", 1, 1)]),
        ("zenoh: {connect: [router]}\nhosts: {a: {addresses: [10.0.0.1]}}\n", [("Y113", 1, 18)]),
        ("zenoh: {connect: [tcp/r:1], mode: x}\nhosts: {a: {addresses: [10.0.0.1]}}\n", [("Y111", 1, 29)]),
        (
            "zenoh: {connect: [tcp/r:1], settings: {A B: 1}}\nhosts: {a: {addresses: [10.0.0.1]}}\n",
            [("Y113", 1, 40)],
        ),
    ],
)
def test_invalid_zenoh_section_is_reported(
    tmp_path: Path, text: str, expected: list[tuple[str, int, int]]
) -> None:
    assert findings(tmp_path, text) == expected


@pytest.mark.parametrize("text", ["zenoh:a b", "zenoh:a/b", "zenoh:a:0", "zenoh:", "zenoh:a:http"])
def test_invalid_zenoh_address_is_refused(text: str) -> None:
    with pytest.raises(AddressError):
        normal_address(text)


def test_host_named_zenoh_is_no_zenoh_address() -> None:
    assert normal_address("zenoh:8181") == "zenoh:8181"
    assert normal_address("zenoh:alpha") == "zenoh:alpha:8181"
