"""The keys of hosts, from the authority on this desk: made if they are missing, renewed before they end."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lfield.authority.key_material import AUTHORITY, REVOKED, Keys, certificate_name, key_name
from lfield.authority.keystore import entry_name, read_keys
from lfield.authority.ledger import Ledger, issued_hosts, open_ledger
from lfield.errors import KeysError
from lfield.provision.installation import RobotFile, key_files

#: The validity of new keys in seconds, and the remaining validity at which they are renewed.
VALIDITY, RENEWAL = 365 * 86400.0, 30 * 86400.0


def has_authority(folder: Path) -> bool:
    """Whether a folder has the authority of a team."""
    return (folder / AUTHORITY).exists()


def planned_keys(folder: Path, names: Iterable[str]) -> dict[str, tuple[RobotFile, ...]]:
    """The keys of each host as they are now, for a dry run; of a host without keys the names of the files."""
    found = {}
    for name in names:
        place = folder / "hosts" / name
        if name in issued_hosts(folder) and (place / key_name("host")).exists():
            found[name] = _files(name, read_keys(place, "host"))
        else:
            found[name] = _files(name, Keys("host", b"", b"", b""))
    return found


def team_keys(folder: Path, names: Iterable[str], now: float) -> dict[str, tuple[RobotFile, ...]]:
    """The files with the keys of each host. Raises KeysError, also for a host whose keys are revoked."""
    with open_ledger(folder) as ledger:
        return {name: _host_files(ledger, name, now) for name in names}


def keys_folder(name: str) -> str:
    """The name of the folder of a host's keys."""
    return entry_name(name)


def _host_files(ledger: Ledger, name: str, now: float) -> tuple[RobotFile, ...]:
    return _files(name, read_keys(_current_folder(ledger, name, now), "host"))


def _files(name: str, keys: Keys) -> tuple[RobotFile, ...]:
    files = (
        (AUTHORITY, keys.authority, False),
        (certificate_name("host"), keys.certificate, False),
        (key_name("host"), keys.key, True),
        (REVOKED, keys.revoked, False),
    )
    return key_files(keys_folder(name), files)


def _current_folder(ledger: Ledger, name: str, now: float) -> Path:
    """The folder of a host's keys; makes or renews them. Raises KeysError."""
    rows = [row for row in ledger.rows(now) if (row.who.kind, row.who.name) == ("host", name)]
    if not rows:
        return ledger.make("host", name, (), now, now + VALIDITY).folder
    valid = [row.who for row in rows if row.state != "revoked"]
    folder = ledger.folder / "hosts" / name
    if not valid:
        raise KeysError(
            f"the keys of host {name} are revoked: if the robot is in your hands again, "
            f"'lfield keys host {name}' makes new ones"
        )
    if max(who.valid_until for who in valid) - now > RENEWAL and (folder / key_name("host")).exists():
        return folder
    # A private key that was deleted from the desk is replaced.
    is_lost = not (folder / key_name("host")).exists()
    return ledger.renew("host", name, now, now + VALIDITY, new_key=is_lost).folder
