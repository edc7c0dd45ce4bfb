"""A throw-away authority, for a run whose hosts are all started by one command: `up --all`, tests.

It is in memory only, and gone with whoever made it. Nobody else can have keys of it, so the links of a run on
the desk are as closed as those of a team, and nobody had to make keys.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lfield.authority.identity import ALL
from lfield.authority.keys import Holder, Keys
from lfield.authority.making import Authority, new_authority

#: They end with the run; what is written in them must not be earlier, however long that is.
LASTS = 10 * 365.25 * 86400.0


@dataclass(frozen=True, slots=True)
class Minted:
    """The keys of the hosts of one run by name, and those of whoever started it, who may do everything."""

    authority: bytes
    hosts: Mapping[str, Keys]
    operator: Keys

    @staticmethod
    def for_hosts(names: Iterable[str], at: float, operator: str = "operator") -> Minted:
        """Keys for hosts of these names, from now (`at`, seconds since 1970 UTC) on."""
        made = new_authority(at, at + LASTS)
        return Minted(
            made.certificate,
            {name: _keys(made, "host", name, at) for name in names},
            _keys(made, "person", operator, at),
        )


def _keys(authority: Authority, holder: Holder, name: str, at: float) -> Keys:
    may = ALL if holder == "person" else ()
    issued = authority.issue(holder, name, may=may, at=at, ends=authority.ends)
    return Keys(holder, authority.certificate, issued.certificate, issued.key)
