"""Did-you-mean suggestions: the known name that is most similar to an unknown one."""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Iterable
from difflib import get_close_matches
from functools import lru_cache

#: The longest name that is compared, and the maximum number of names with which it is compared.
MAX_LENGTH, MAX_NAMES = 64, 100
#: The maximum number of names that a hint lists in full, and the maximum number of similar names in place of
#: a longer list.
MAX_LISTED, MAX_SIMILAR = 8, 3

#: The words of a name such as goToGlobal.
_NAME_PART = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+")


def closest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most similar, or None; case is ignored.

    Among more than MAX_NAMES names only the alphabetical neighbours are compared, so that a file with
    thousands of errors is checked in seconds.
    """
    if len(name) > MAX_LENGTH:
        return None
    names = sorted(known)
    if len(names) > MAX_NAMES:
        at = bisect(names, name)
        names = names[max(at - MAX_NAMES // 2, 0) : at + MAX_NAMES // 2]
    return _closest(name.lower(), tuple(names))


@lru_cache(maxsize=64)
def _closest(name: str, known: tuple[str, ...]) -> str | None:
    """The result of `closest`, cached because one missing declaration causes the same look-up at each use."""
    by_lower = {k.lower(): k for k in known}
    found = get_close_matches(name, list(by_lower), n=1, cutoff=0.65)
    return by_lower[found[0]] if found else None


def did_you_mean(name: str, known: Iterable[str]) -> str | None:
    """`did you mean 'x'?`, or None when no name is similar."""
    close = closest(name, known)
    return f"did you mean '{close}'?" if close is not None else None


def similar(name: str, known: Iterable[str]) -> list[str]:
    """Up to MAX_SIMILAR names that share a word with an unknown one, or otherwise resemble it; [] for none.

    Only the first MAX_NAMES known names are compared.
    """
    if len(name) > MAX_LENGTH:
        return []
    names = list(known)[:MAX_NAMES]
    parts = _name_parts(name)
    sharing = [candidate for candidate in names if parts & _name_parts(candidate)]
    return get_close_matches(name, sharing, MAX_SIMILAR, 0.0) or get_close_matches(
        name, names, MAX_SIMILAR, 0.5
    )


def _name_parts(name: str) -> set[str]:
    return {part.lower() for part in _NAME_PART.findall(name)}


def choice(name: str, known: Iterable[str], intro: str) -> str:
    """The hint for an unknown name: after `intro` all names if they are few, else similar or some names."""
    names = list(known)
    if len(names) <= MAX_LISTED:
        return f"{intro} {listed(names)}"
    if similar_names := similar(name, names):
        return f"similar names: {listed(similar_names)}"
    return f"{intro} {', '.join(names[:MAX_LISTED])}, ..."


def listed(names: Iterable[str], nothing: str = "none") -> str:
    """Names for a sentence: `a, b and c`."""
    items = list(names)
    if not items:
        return nothing
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
