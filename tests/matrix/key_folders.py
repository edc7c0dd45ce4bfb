"""Folders with valid and invalid keys, for the start of a host."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from certificates import NOT_BEFORE, Team, made
from host_start import does_host_start
from network_callers import NOW
from signed_bundles import sealed

from lfield.authority import keystore
from lfield.authority.identity import Right, uri_of
from lfield.authority.key_material import Keys, certificate_name, key_name
from lfield.mission import bundle
from lfield.mission.loader import load_mission

DAY = 86400.0
#: The host that starts, and its minimum lifetime in seconds, by column.
STARTS = {"alpha": ("alpha", 3600.0), "bravo": ("bravo", 3600.0), "long": ("alpha", 10 * DAY)}
FILES = {
    ".L": "coordinator Idler { init(string[] arg) { } }\n",
    ".dL": "//Idler:tom@alpha\n//Idler:ann@bravo\n",
}


class Folders:
    """A folder for each row, and a bundle that hosts of the team run."""

    def __init__(self, base: Path) -> None:
        self._base, team, other = base, Team(), Team()
        alpha, bravo = team.host("alpha"), team.host("bravo")
        anna = team.person("anna", *Right)
        soon, ended = team.host("alpha", end=NOW + 5 * DAY), team.host("alpha", end=NOW - DAY)
        found: dict[str, Keys] = {
            "good": alpha,
            "early": alpha,
            "soon": soon,
            "ended": ended,
            "revoked": replace(alpha, revoked=team.revoked(1, alpha)),
            "other_list": replace(alpha, revoked=other.revoked(1)),
            "readable": alpha,
            "other_host": bravo,
            "person": replace(anna, holder="host"),
            "mixed": replace(alpha, key=bravo.key),
            "selfsigned": team.with_(made("alpha", [uri_of("host", "alpha")])),
            "foreign": replace(other.host("alpha"), authority=team.authority.certificate),
            "page": team.page(),
            "cut": replace(alpha, key=alpha.key[: len(alpha.key) // 2]),
        }
        for name, keys in found.items():
            keystore.write_keys(base / name, replace(keys, revoked=keys.revoked or team.revoked(0)))
            assert (base / name / certificate_name("host")).is_file()
        (base / "readable" / key_name("host")).chmod(0o640)
        for ending, text in FILES.items():
            (base / f"mission{ending}").write_text(text)
        data = bundle.encode(load_mission(base / "mission.dL"))
        self._bundle = base / f"mission{bundle.SUFFIX}"
        # With the clock of 1970, the time is that of the oldest certificate.
        self._bundle.write_bytes(bundle.with_signature(data, sealed(data, anna, NOT_BEFORE.timestamp())))

    def tried(self, who: str, what: str) -> bool:
        """Whether a host starts with that folder."""
        host, lasts = STARTS[what]
        at = 1000.0 if who == "early" else NOW
        return does_host_start(self._bundle, host, self._base / who, at, "--lasts", str(lasts))
