"""Warnings of host names in a deployment that are probably misspelt.

Only a host that occurs on one line is suspected. It is reported if it resembles another host, if there is an
inventory that has other hosts of the deployment and not this one, or if it is the only one of its kind.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence

from lfield.lang import messages
from lfield.lang.deployment_line import DeploymentEntry, is_address
from lfield.text.source_text import Diagnostics
from lfield.text.suggestions import MAX_LISTED, did_you_mean, listed

#: Shorter names differ by one letter on purpose.
_SHORTEST_COMPARED = 4
#: A team of fewer hosts often has one with a single agent, such as a base station.
_FEWEST_OTHERS = 3
#: Another letter is a typing mistake only if its key is beside the right one: `left` and `lift` both exist.
_KEY_ROWS = ("1234567890-", "qwertyuiop", "asdfghjkl", "zxcvbnm_")


def check_hosts(
    entries: Sequence[DeploymentEntry], inventory: Collection[str], diagnostics: Diagnostics
) -> None:
    """Report the hosts on one line that are probably misspelt; `inventory` has those that have keys."""
    counts = Counter(entry.host.text for entry in entries)
    lines = {entry.host.text: entry.host.line for entry in reversed(entries)}
    repeated = [host for host, count in counts.items() if count > 1]
    lone = [entry for entry in entries if counts[entry.host.text] == 1]
    is_relevant = any(host in inventory for host in counts)
    # Only hosts with the same digits and domain are compared: a large team has numbered hosts.
    known_by_key = defaultdict[tuple[str, str], list[str]](list)
    for host in repeated:
        known_by_key[_key(host)].append(host)
    for entry in lone:
        host = entry.host.text
        similar = known_by_key[_key(host)]
        close = next((other for other in similar if _resembles(host, other)), None)
        similar.append(host)
        if host in inventory:
            continue
        if close is not None:
            diagnostics.add(messages.LONE_HOST.at(entry.host, host=host, close=close, line=lines[close]))
        elif is_relevant:
            known = sorted(inventory)
            hint = did_you_mean(host, known) or f"hosts with keys: {_sample_text(known)}"
            reason = f"it has no keys, and no other line names it; 'lfield keys host {host}' makes its keys"
            diagnostics.add(messages.UNKNOWN_HOST.at(entry.host, hint=hint, host=host, reason=reason))
    if not inventory and len(lone) == 1 and len(repeated) >= _FEWEST_OTHERS:
        _check_only_lone(lone[0], repeated, entries, diagnostics)


def _check_only_lone(
    entry: DeploymentEntry, others: Sequence[str], entries: Iterable[DeploymentEntry], found: Diagnostics
) -> None:
    """Report the one host with a single agent, if other hosts have agents of the same type."""
    host = entry.host.text
    has_peers = any(each.type.text == entry.type.text for each in entries if each is not entry)
    is_compared = any(_resembles(host, other) for other in others)
    if has_peers and not (entry.is_witness or is_address(host) or is_compared):
        hint = did_you_mean(host, others) or f"the other hosts are {_sample_text(others)}"
        reason = "it occurs on this line only, and each other host on several"
        found.add(messages.UNKNOWN_HOST.at(entry.host, hint=hint, host=host, reason=reason))


def _sample_text(names: Sequence[str]) -> str:
    """The first names of a list, for a hint."""
    if len(names) <= MAX_LISTED:
        return listed(names)
    return f"{', '.join(names[:MAX_LISTED])} and {len(names) - MAX_LISTED} more"


def _key(host: str) -> tuple[str, str]:
    """The digits and the domain of a host name."""
    name, _, domain = host.partition(".")
    return re.sub(r"\D", "", name), domain


def _resembles(host: str, other: str) -> bool:
    """Whether two host names differ by one typing mistake (Damerau-Levenshtein distance 1).

    A different last character (alpha1 and alpha2, arm-a and arm-b), different digits, and a letter whose key
    is not beside that of the other one are no mistake.
    """
    name, known = host.partition(".")[0], other.partition(".")[0]
    if name[:1] in "0123456789[" or min(len(name), len(known)) < _SHORTEST_COMPARED:
        return False
    if _key(host) != _key(other) or name[:-1] == known[:-1]:
        return False
    if name.lower() == known.lower():
        return False  # such hosts are reported as L709
    start = next((at for at, (a, b) in enumerate(zip(name, known, strict=False)) if a != b), len(known))
    rest, known_rest = name[start:], known[start:]
    if rest[1:] == known_rest[1:]:
        return _are_neighbours(rest[:1].lower(), known_rest[:1].lower())
    transposed = rest[2:] == known_rest[2:] and rest[:2] == known_rest[1::-1]
    return transposed or rest[1:] == known_rest or rest == known_rest[1:]


def _are_neighbours(first: str, second: str) -> bool:
    """Whether the keys of two characters touch, each row being half a key to the right of that above."""
    places = {key: (row, at) for row, keys in enumerate(_KEY_ROWS) for at, key in enumerate(keys)}
    if first not in places or second not in places:
        return False
    (row, at), (other_row, other_at) = sorted((places[first], places[second]))
    return abs(at - other_at) == 1 if row == other_row else other_row == row + 1 and at - other_at in (0, 1)
