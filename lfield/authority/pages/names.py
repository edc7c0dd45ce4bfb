"""What a page may be called: addresses and names, spelled as browsers and certificates do.

The root for browsers (`browsers.py`) can vouch for what is private alone: whoever steals its key can pass for
no page of the internet, and there it is not needed, since anybody's certificates can be had for public names.
"""

from __future__ import annotations

import re
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from lfield.errors import KeysError

Address = IPv4Address | IPv6Address

#: Private networks: RFC 1918, carriers' (and VPNs': RFC 6598), link-local, the own computer, RFC 4193.
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
#: What no name of the internet ends in: RFC 6762, RFC 8375, ICANN's of 2024, and what many routers say.
ENDINGS = ("local", "home.arpa", "internal", "lan")

_LABEL = "[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
_NAME = re.compile(rf"{_LABEL}(\.{_LABEL})*", re.ASCII)
#: The longest name in DNS.
_MOST = 253


def address_in(text: str) -> Address | None:
    """The address that a text is, None for a name. IPv6 may stand in brackets."""
    bare = text[1:-1] if text.startswith("[") and text.endswith("]") else text
    try:
        return ip_address(bare)
    except ValueError:
        return None


def spelled(text: str) -> str:
    """An address or name as browsers spell it, IPv6 without brackets. Raises KeysError for anything else."""
    address = address_in(text)
    if address is not None and not (address.is_unspecified or address.is_multicast or "%" in text):
        return str(address)
    name = text.lower()
    # A name of digits alone would be an address, somewhere.
    if address is None and len(name) <= _MOST and _NAME.fullmatch(name) and not name.split(".")[-1].isdigit():
        return name
    raise KeysError(
        f"'{text}' is no address or name that a browser could open a page by: give one such as 192.168.1.20 "
        "or ground.local"
    )


def private(name: str) -> bool:
    """Whether a name, spelled as above, is one of a private network."""
    address = address_in(name)
    if address is not None:
        return any(address in network for network in NETWORKS)
    return name.endswith(tuple(f".{ending}" for ending in ENDINGS))


def covers(pattern: str, name: str) -> bool:
    """Whether a name in a certificate is that name: `*` stands for one label of it."""
    if pattern.startswith("*.") and address_in(name) is None:
        return pattern[2:] == name.partition(".")[2] != ""
    return pattern == name
