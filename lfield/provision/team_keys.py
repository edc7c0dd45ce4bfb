"""The keys of hosts, from the authority on this desk: made if they are missing, renewed before they end."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lfield.authority.key_material import AUTHORITY, MAX_PEM, REVOKED, Keys, certificate_name, key_name
from lfield.authority.keystore import entry_name, read_crl, read_file, read_keys, read_trusted
from lfield.authority.ledger import Ledger, issued_hosts, open_ledger
from lfield.errors import KeysError
from lfield.provision.installation import RobotFile, key_files

#: The validity of new keys in seconds, and the remaining validity at which they are renewed.
VALIDITY, RENEWAL = 365 * 86400.0, 30 * 86400.0


def has_authority(folder: Path) -> bool:
    """Whether a folder has the authority of a team."""
    return (folder / AUTHORITY).exists()


def planned_keys(folder: Path, names: Iterable[str]) -> dict[str, tuple[RobotFile, ...]]:
    """The present keys of each host, for a dry run; of a host without keys the names of the files."""
    found = {}
    for name in names:
        place = folder / "hosts" / name
        if name in issued_hosts(folder) and (place / certificate_name("host")).exists():
            found[name] = _files_in(place, name)
        else:
            found[name] = _files(name, Keys("host", read_file(folder / AUTHORITY, MAX_PEM), b"", b""))
    return found


def team_keys(folder: Path, names: Iterable[str], now: float) -> dict[str, tuple[RobotFile, ...]]:
    """The files with the keys of each host. Raises KeysError, also for a host whose keys are revoked."""
    with open_ledger(folder) as ledger:
        return {name: _host_files(ledger, name, now) for name in names}


def replaced_keys(folder: Path, name: str, now: float) -> tuple[RobotFile, ...]:
    """New keys for a host, whose private key is neither on this desk nor on the robot. Raises KeysError."""
    with open_ledger(folder) as ledger:
        ledger_keys = ledger.renew("host", name, now, now + VALIDITY, new_key=True)
        return _files(name, read_keys(ledger_keys.folder, "host"))


def keys_folder(name: str) -> str:
    """The name of the folder of a host's keys."""
    return entry_name(name)


def _host_files(ledger: Ledger, name: str, now: float) -> tuple[RobotFile, ...]:
    return _files_in(_current_folder(ledger, name, now), name)


def _files_in(folder: Path, name: str) -> tuple[RobotFile, ...]:
    """The files in a folder of the authority, whose private key may have been deleted."""
    if (folder / key_name("host")).exists():
        return _files(name, read_keys(folder, "host"))
    certificate = read_file(folder / certificate_name("host"), MAX_PEM)
    return _files(name, Keys("host", read_trusted(folder), certificate, b"", read_crl(folder, needed=True)))


def _files(name: str, keys: Keys) -> tuple[RobotFile, ...]:
    files = (
        (AUTHORITY, keys.authority, False),
        (certificate_name("host"), keys.certificate, False),
        (key_name("host"), keys.key, True),
        (REVOKED, keys.revoked, False),
    )
    return key_files(keys_folder(name), [file for file in files if file[1] or not file[2]])


def _current_folder(ledger: Ledger, name: str, now: float) -> Path:
    """The folder of a host's keys; makes or renews them. Raises KeysError."""
    rows = [row for row in ledger.rows(now) if (row.identity.kind, row.identity.name) == ("host", name)]
    if not rows:
        return ledger.make("host", name, (), now, now + VALIDITY).folder
    valid = [row.identity for row in rows if row.state != "revoked"]
    folder = ledger.folder / "hosts" / name
    if not valid:
        raise KeysError(
            f"the keys of host {name} are revoked: if the robot is in your hands again, "
            f"'lfield keys host {name}' makes new ones"
        )
    if (
        max(identity.valid_until for identity in valid) - now > RENEWAL
        and (folder / certificate_name("host")).exists()
    ):
        return folder
    return ledger.renew("host", name, now, now + VALIDITY).folder
