"""Reads an inventory file.

```yaml
hosts:
  alpha:
    addresses: [10.42.0.11, "[fd00::11]:8181", "fe80::1%wlan0", "zenoh:alpha"]    # in order of preference
    user: pi                     # of ssh; default: that of the configuration of ssh
    ssh_port: 22
    ssh_host: alpha.local        # default: the addresses, in order
    arch: aarch64                # aarch64, x86_64 or armv7l
    python: "3.11"               # on the robot, if wheels are prepared while it is off
    service_port: 8182
    groups: [gpio]               # more groups of the service, for ports
    files: [motor.dbc]           # that its devices need; relative to this file
    devices: alpha.devices.yaml  # of this robot alone; relative to this file
    options: [--sim]             # of 'lfield up' for the mission's host: simulated devices
    zenoh: {connect: [tcp/10.0.0.1:7447]}    # instead of that of the team
zenoh: {connect: [tcp/192.0.2.10:7447]}      # for addresses zenoh:NAME; `zenoh_section` has all keys
```

All errors are reported at once, each at its position.
"""

from __future__ import annotations

import re
from ipaddress import IPv6Address, ip_address
from pathlib import Path

from lfield.errors import AddressError, ProgramError
from lfield.inventory.inventory import ARCHITECTURES, SERVICE_PORT, Inventory, InventoryHost
from lfield.inventory.zenoh_section import read_zenoh_section
from lfield.net.transport import DEFAULT_PORT, is_zenoh, join_address, split_address
from lfield.text.source_text import Diagnostics, Span
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlList, YamlNode, YamlScalar, read

#: Not a dash first: the text would be an option of ssh.
_NAME = re.compile(r"(?!-)[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*", re.ASCII)
_USER = re.compile(r"[a-z_][a-z0-9_-]*\$?", re.ASCII)
_SSH_HOST = re.compile(r"(?!-)[A-Za-z0-9._:%-]+", re.ASCII)
_PYTHON = re.compile(r"3\.\d{1,2}", re.ASCII)


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
        #: The host of each address: "host:port" in a normal form.
        self._owners: dict[str, str] = {}
        #: The names of hosts in lower case.
        self._names: dict[str, str] = {}

    def inventory(self, node: YamlNode) -> Inventory:
        top = YamlFields(node, self._found, "an inventory")
        section = top.section("hosts")
        hosts = {entry.key: self._host(entry, fields) for entry, fields in section.entries()}
        if not hosts:
            top.report("Y110", "an inventory needs 'hosts', with at least one", section.span, _EXAMPLE)
        zenoh = read_zenoh_section(top)
        for name, host in hosts.items():
            if zenoh is None and host.zenoh is None and any(map(is_zenoh, host.addresses)):
                hint = "zenoh: {connect: [tcp/192.0.2.10:7447]}"
                top.report("Y110", f"the address of {name} needs a section 'zenoh'", section.span, hint)
        top.report_unread()
        return Inventory(self._path, hosts, zenoh)

    def _host(self, entry: YamlEntry, fields: YamlFields) -> InventoryHost:
        name = entry.key
        if not _NAME.fullmatch(name):
            hint = "letters, digits, '-' and '.', as in the deployment"
            fields.report("Y113", f"'{name}' is not a name of a host", entry.key_span, hint)
        if (first := self._names.setdefault(name.lower(), name)) != name:
            fields.report("Y113", f"'{name}' differs from '{first}' by upper case only", entry.key_span)
        port = fields.integer("service_port", SERVICE_PORT, minimum=1, maximum=65535)
        addresses = self._addresses(name, port, fields)
        python = self._matching("python", _PYTHON, 'a version of Python, as in "3.11"', fields)
        user = self._matching("user", _USER, "a name of a user", fields)
        groups = fields.texts("groups")
        for group in groups:
            if not _USER.fullmatch(group):
                fields.report("Y113", f"'{group}' is not a name of a group", fields.value_span("groups"))
        devices = fields.text("devices")
        host = InventoryHost(
            name,
            addresses,
            user,
            fields.integer("ssh_port", 0, minimum=1, maximum=65535),
            self._matching("ssh_host", _SSH_HOST, "a host for ssh", fields),
            fields.text("arch", choices=ARCHITECTURES),
            python,
            port,
            groups,
            (self._path.parent / devices).absolute() if devices else None,
            tuple((self._path.parent / file).absolute() for file in fields.texts("files")),
            self._options(fields),
            read_zenoh_section(fields),
        )
        fields.report_unread()
        return host

    def _matching(self, key: str, pattern: re.Pattern[str], expected: str, fields: YamlFields) -> str:
        """A text that matches; '' without it, and with a finding."""
        text = fields.text(key)
        if not text or pattern.fullmatch(text):
            return text
        fields.report("Y113", f"'{text}' is not {expected}", fields.value_span(key))
        return ""

    def _options(self, fields: YamlFields) -> tuple[str, ...]:
        """The options of `lfield up`; each is one word, with its value after "="."""
        options = fields.texts("options")
        for option in options:
            if not option.startswith("--"):
                hint = "write [--sim], or [--lost-after=600]"
                fields.report("Y113", f"'{option}' is not an option", fields.value_span("options"), hint)
        return options

    def _addresses(self, name: str, service_port: int, fields: YamlFields) -> tuple[str, ...]:
        """The addresses of a host, each with its port."""
        addresses: list[str] = []
        nodes, value = fields.items("addresses"), fields.node("addresses")
        for node in nodes:
            if not isinstance(node, YamlScalar) or not isinstance(node.value, str):
                fields.report("Y112", "an address must be text", node.span, 'write "10.42.0.11"')
                continue
            try:
                address = normal_address(node.value)
            except AddressError as error:
                sentence = f"'{node.value}' is not an address of a host: {error.reason}"
                fields.report("Y113", sentence, node.span, _ADDRESSES)
                continue
            if address in addresses:
                fields.report("Y113", f"{address} occurs twice", node.span)
            self._own(name, address, service_port, node.span, fields)
            addresses.append(address)
        if value is None or (isinstance(value, YamlList) and not nodes):
            fields.report(
                "Y110", f"'{name}' needs at least one address under 'addresses'", fields.span, _HOST
            )
        return tuple(addresses)

    def _own(self, name: str, address: str, service_port: int, span: Span, fields: YamlFields) -> None:
        """Record the ports of a host at an address; a finding if another host has one of them."""
        host, port = split_address(address)
        if port == service_port:
            hint = "the mission's host and the service listen at different ports"
            fields.report("Y113", f"{address} is also the address of the service of {name}", span, hint)
        for endpoint in (join_address(host, port), join_address(host, service_port)):
            other = self._owners.setdefault(endpoint, name)
            if other != name:
                fields.report(
                    "Y113", f"{endpoint} is an address of {other} too", span, "every host has its own"
                )
                return


_EXAMPLE = "hosts: {alpha: {addresses: [10.42.0.11]}}"
_HOST = "write addresses: [10.42.0.11]"
_ADDRESSES = "write HOST, HOST:PORT, IPv6, [IPv6]:PORT, [IPv6%INTERFACE]:PORT or zenoh:NAME"


def normal_address(text: str) -> str:
    """An address as "host:port" in its normal form; IPv6 may lack its brackets. Raises AddressError."""
    if is_zenoh(text):
        host, port = split_address(text)
        if not port:
            raise AddressError(text, "0 is not a port; write a number from 1 to 65535")
        return join_address(host, port)
    is_bare = text.partition("%")[0].count(":") > 1 and not text.startswith("[")
    host, port = (text, DEFAULT_PORT) if is_bare else split_address(text)
    if not port:
        raise AddressError(text, "0 is not a port; write a number from 1 to 65535")
    if ":" in host or re.fullmatch(r"[0-9.]+", host):
        host = _normal_number(text, host)
    elif not _NAME.fullmatch(host):
        raise AddressError(text, "it contains characters that are not allowed in a host name")
    return join_address(host.lower() if "%" not in host else host, port)


def _normal_number(text: str, host: str) -> str:
    """An IP address in its normal form. Raises AddressError."""
    try:
        address = ip_address(host)
    except ValueError:
        raise AddressError(text, "it is not an IP address") from None
    if address.is_unspecified or address.is_multicast:
        raise AddressError(text, "it is not the address of one computer")
    zone = getattr(address, "scope_id", None)
    if isinstance(address, IPv6Address) and address.is_link_local and not zone:
        raise AddressError(text, "a link-local address needs the interface, as in fe80::1%wlan0")
    if zone and not address.is_link_local:
        raise AddressError(text, "only a link-local address has an interface")
    return str(address)
