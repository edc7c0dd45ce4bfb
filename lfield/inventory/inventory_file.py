"""Reads an inventory file.

```yaml
hosts:
  alpha:
    addresses: [10.42.0.11, "[fd00::11]:8181", "fe80::1%wlan0"]  # in order of preference
    user: pi                     # of ssh; default: what ssh is configured for
    ssh_port: 22
    ssh_host: alpha.local        # default: the addresses, in order
    arch: aarch64                # aarch64, x86_64 or armv7l
    python: "3.11"               # on the robot, if wheels are prepared while it is off
    service_port: 8182
    groups: [gpio]               # more groups of the service, for ports
    devices: alpha.devices.yaml  # of this robot alone; relative to this file
```

All errors are reported at once, each at its position.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from ipaddress import ip_address
from pathlib import Path

from lfield.errors import AddressError, NoHomeFolder, ProgramError
from lfield.inventory.inventory import ARCHITECTURES, SERVICE_PORT, Inventory, InventoryHost
from lfield.net.transport import DEFAULT_PORT, join_address, split_address
from lfield.text.source_text import Diagnostics, Span
from lfield.text.user_dirs import config_dir
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlNode, YamlScalar, read

#: The variable that names the file, and the file of a robot.
VARIABLE, SYSTEM = "LFIELD_INVENTORY", Path("/etc/lfield/inventory.yaml")
_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?", re.ASCII)
_USER = re.compile(r"[a-z_][a-z0-9_-]*\$?", re.ASCII)
_PYTHON = re.compile(r"3\.(\d{1,2})", re.ASCII)
#: The oldest minor version of Python 3 that lfield runs on.
_OLDEST_PYTHON = 11


def find_inventory(named: Path | None, environment: Mapping[str, str]) -> Inventory | None:
    """The inventory of a command: `named`, else $LFIELD_INVENTORY, else the user's, else that of the robot.

    None without any. Raises as `read_inventory`.
    """
    said = named or (Path(environment[VARIABLE]) if environment.get(VARIABLE) else None)
    if said is not None:
        return read_inventory(said)
    try:
        own = config_dir() / "inventory.yaml"
    except NoHomeFolder:
        own = SYSTEM
    return next((read_inventory(path) for path in (own, SYSTEM) if path.exists()), None)


def read_inventory(path: Path) -> Inventory:
    """The inventory in a file. Raises ProgramError with all errors, InputFileError."""
    found = Diagnostics()
    node = read(str(path), found)
    inventory = _Reader(path, found).inventory(node) if node is not None else Inventory(path)
    if found.errors:
        raise ProgramError(found.errors)
    return inventory


class _Reader:
    """One pass over a file; errors go to `found`."""

    def __init__(self, path: Path, found: Diagnostics) -> None:
        self._path, self._found = path, found
        #: Which host has each address: "host:port" in a normal form.
        self._owners: dict[str, str] = {}

    def inventory(self, node: YamlNode) -> Inventory:
        top = YamlFields(node, self._found, "an inventory")
        section = top.section("hosts")
        hosts = {entry.key: self._host(entry, fields) for entry, fields in section.entries()}
        if not hosts:
            top.report("Y110", "an inventory needs 'hosts', with at least one", section.span, _EXAMPLE)
        top.report_unread()
        return Inventory(self._path, hosts)

    def _host(self, entry: YamlEntry, fields: YamlFields) -> InventoryHost:
        name = entry.key
        if not _NAME.fullmatch(name):
            hint = "letters, digits, '-' and '.', as in the deployment"
            fields.report("Y113", f"'{name}' is not a name of a host", entry.key_span, hint)
        port = fields.integer("service_port", SERVICE_PORT, minimum=1, maximum=65535)
        addresses = self._addresses(name, port, fields)
        python = fields.text("python")
        if python and not ((match := _PYTHON.fullmatch(python)) and int(match[1]) >= 10):
            fields.report(
                "Y113", f"'{python}' is not a version of Python", fields.value_span("python"), 'write "3.11"'
            )
        user = fields.text("user")
        if user and not _USER.fullmatch(user):
            fields.report("Y113", f"'{user}' is not a name of a user", fields.value_span("user"))
        devices = fields.text("devices")
        host = InventoryHost(
            name,
            addresses,
            user,
            fields.integer("ssh_port", 0, minimum=1, maximum=65535) if "ssh_port" in fields else 0,
            fields.text("ssh_host"),
            fields.text("arch", choices=ARCHITECTURES),
            python,
            port,
            fields.texts("groups"),
            (self._path.parent / devices).absolute() if devices else None,
        )
        fields.report_unread()
        return host

    def _addresses(self, name: str, service_port: int, fields: YamlFields) -> tuple[str, ...]:
        """The addresses of a host, each with its port."""
        found: list[str] = []
        for node in fields.items("addresses"):
            if not isinstance(node, YamlScalar) or not isinstance(node.value, str):
                fields.report("Y112", "an address must be text", node.span, 'write "10.42.0.11"')
            elif address := self._address(node.value, node.span, fields):
                self._own(name, address, service_port, node.span, fields)
                found.append(address)
        if not found and not fields.items("addresses"):
            fields.report("Y110", f"'{name}' needs 'addresses', with at least one", fields.span)
        return tuple(found)

    def _address(self, text: str, span: Span, fields: YamlFields) -> str:
        """An address with its port; '' and a finding for an invalid one."""
        try:
            host, port = _with_port(text)
            if not port:
                raise AddressError(text, "0 is not a port; write a number from 1 to 65535")
            if host.replace(".", "").isdigit():
                ip_address(host)
        except AddressError as error:
            fields.report("Y113", f"'{text}' is not an address: {error.reason}", span, _ADDRESSES)
            return ""
        except ValueError:
            fields.report("Y113", f"'{text}' is not an address", span, _ADDRESSES)
            return ""
        if not _is_host(host):
            fields.report("Y113", f"'{text}' is not an address", span, _ADDRESSES)
            return ""
        return join_address(host, port)

    def _own(self, name: str, address: str, service_port: int, span: Span, fields: YamlFields) -> None:
        """Record the ports of a host at an address; a finding where another host has one of them."""
        host, port = split_address(address)
        if port == service_port:
            hint = "the mission's host and the service listen at different ports"
            fields.report("Y113", f"{address} is also the address of the service of {name}", span, hint)
        for endpoint in (join_address(host.lower(), port), join_address(host.lower(), service_port)):
            other = self._owners.setdefault(endpoint, name)
            if other != name:
                fields.report(
                    "Y113", f"{endpoint} is an address of {other} too", span, "every host has its own"
                )
                return


_EXAMPLE = "hosts: {alpha: {addresses: [10.42.0.11]}}"
_ADDRESSES = "write HOST, HOST:PORT, IPv6, [IPv6]:PORT or [IPv6%INTERFACE]:PORT"


def _with_port(text: str) -> tuple[str, int]:
    """Host and port of an address, which for IPv6 may lack its brackets. Raises AddressError."""
    bare = text.partition("%")[0]
    if bare.count(":") > 1 and not text.startswith("["):
        return text, DEFAULT_PORT
    return split_address(text)


def _is_host(host: str) -> bool:
    """Whether it is an IP address, with a zone if it is link-local, or can be a name."""
    bare, percent, zone = host.partition("%")
    if ":" in bare:
        try:
            address = ip_address(bare)
        except ValueError:
            return False
        return bool(zone) if address.is_link_local else not percent
    return bool(_NAME.fullmatch(host))
