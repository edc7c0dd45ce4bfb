"""The names of a web page: addresses and host names, in the normal form of browsers and certificates.

The root CA for browsers (`browser_ca.py`) is limited to private networks: a stolen key cannot impersonate a
page of the internet, where certificates of public CAs are available anyway.
"""

from __future__ import annotations

import re
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from lfield.errors import KeysError

Address = IPv4Address | IPv6Address

#: Private networks: RFC 1918, carrier-grade NAT (and VPNs: RFC 6598), link-local, loopback, RFC 4193.
NETWORKS: tuple[IPv4Network | IPv6Network, ...] = tuple(
    map(
        ip_network,
        (
            *("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16"),
            *("100.64.0.0/10", "169.254.0.0/16", "127.0.0.0/8"),
            *("fc00::/7", "fe80::/10"),
        ),
    )
)
#: Private top-level domains: RFC 6762, RFC 8375, ICANN's of 2024, and common defaults of routers.
ENDINGS = ("local", "home.arpa", "internal", "lan")

_LABEL = "[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
_NAME = re.compile(rf"{_LABEL}(\.{_LABEL})*", re.ASCII)
#: The longest name in DNS.
_MAX_LENGTH = 253


def address_in(text: str) -> Address | None:
    """The address in a text; None for a name. IPv6 may be in brackets."""
    number = text[1:-1] if text.startswith("[") and text.endswith("]") else text
    try:
        return ip_address(number)
    except ValueError:
        return None


def normalised(text: str) -> str:
    """An address or name in the normal form of browsers, IPv6 without brackets. Raises KeysError."""
    address = address_in(text)
    if address is not None and not (address.is_unspecified or address.is_multicast or "%" in text):
        return str(address)
    name = text.lower()
    # A name of digits only would be an address in some parsers.
    if (
        address is None
        and len(name) <= _MAX_LENGTH
        and _NAME.fullmatch(name)
        and not name.split(".")[-1].isdigit()
    ):
        return name
    raise KeysError(
        f"'{text}' is not an address or name for browsers: give one such as 192.168.1.20 or ground.local"
    )


def is_private_name(name: str) -> bool:
    """Whether a normalised name is one of a private network."""
    address = address_in(name)
    if address is not None:
        return any(address in network for network in NETWORKS)
    return name.endswith(tuple(f".{suffix}" for suffix in ENDINGS))


def is_match(pattern: str, name: str) -> bool:
    """Whether a pattern in a certificate matches a name: `*` matches one label."""
    if pattern.startswith("*.") and address_in(name) is None:
        return pattern[2:] == name.partition(".")[2] != ""
    return pattern == name
