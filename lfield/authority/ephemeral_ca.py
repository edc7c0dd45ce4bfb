"""An ephemeral CA for a run whose hosts are all started by one command: `up --all`, tests.

The CA is in memory only, so no other process can obtain its keys: the links of such a run are as protected as
those of a team, without `lfield keys`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct

from lfield.authority.certificate_authority import CertificateAuthority, new_authority
from lfield.authority.identity import ALL_RIGHTS
from lfield.authority.key_material import Holder, Keys

#: Validity. The certificates end with the run; the value must exceed any run.
LIFETIME = 10 * 365.25 * 86400.0


class EphemeralCa(Struct, frozen=True):
    """The keys of the hosts of one run by name, and those of the user who started it, who has every right."""

    authority: bytes
    hosts: Mapping[str, Keys]
    operator: Keys

    @staticmethod
    def for_hosts(names: Iterable[str], at: float, operator: str = "operator") -> EphemeralCa:
        """Keys for hosts of these names, from now (`at`, seconds since 1970 UTC) on."""
        ca = new_authority(at, at + LIFETIME)
        return EphemeralCa(
            ca.certificate,
            {name: _keys(ca, "host", name, at) for name in names},
            _keys(ca, "person", operator, at),
        )


def _keys(authority: CertificateAuthority, holder: Holder, name: str, at: float) -> Keys:
    may = ALL_RIGHTS if holder == "person" else ()
    issued = authority.issue(holder, name, may=may, at=at, ends=authority.valid_until)
    return Keys(holder, authority.certificate, issued.certificate, issued.key)
