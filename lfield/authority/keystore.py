"""Key folders: where `up` and the commands search for them, and how they are read and written.

In order of precedence, for host alpha and for an operator:

    --keys DIR                           DIR itself, or the folder in it of that name
    $LFIELD_KEYS                         the same
    /etc/lfield/keys/alpha               /etc/lfield/keys/me
    ~/.config/lfield/keys/alpha          ~/.config/lfield/keys/me

If a folder that is named does not exist, that is an error; no other folder is searched. `key_material.py`
lists the files. A folder or file that other users can write to is refused, and so is a private key that
other users can read. A symbolic link to a folder is followed; the owner of the target counts. A file that
is a symbolic link is not read.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from lfield.authority.key_material import (
    AUTHORITY,
    MAX_LIST,
    MAX_PEM,
    REVOKED,
    Holder,
    Keys,
    certificate_name,
    key_name,
)
from lfield.errors import KeysError, NoHomeFolder, OutputFileError
from lfield.text.secure_files import read_private, write_private
from lfield.text.user_dirs import config_dir

#: The folder of an operator's keys; that of a host has the host's name.
OWN = "me"
#: The system folder of the keys of hosts, and the environment variable that replaces it.
SYSTEM, VARIABLE = Path("/etc/lfield/keys"), "LFIELD_KEYS"
#: The environment variable that names the folder of the CA.
AUTHORITY_VARIABLE = "LFIELD_AUTHORITY"


def find_keys(
    holder: Holder,
    name: str,
    named: Path | None,
    environment: Mapping[str, str],
    system: Path = SYSTEM,
) -> Path | None:
    """The folder with the keys of a host (`name`) or of this user (`OWN`); None if there is none.

    `named` is the value of --keys. Raises KeysError if a named folder has no such keys.
    """
    named_folder = named or (Path(environment[VARIABLE]) if environment.get(VARIABLE) else None)
    default_folders = [_entry_path(base, name) for base in _default_folders(system)]
    for folder in (
        (named_folder, _entry_path(named_folder, name)) if named_folder is not None else default_folders
    ):
        # A folder that this user cannot read counts as missing.
        if os.path.exists(folder / certificate_name(holder)):
            return folder
    if named_folder is not None:
        whose = f"host {name}" if holder == "host" else "a person"
        raise KeysError(
            f"{named_folder} has no keys of {whose} that this user may read ({certificate_name(holder)}): "
            f"copy there what 'lfield keys {holder}' has made"
        )
    return None


def local_folders(environment: Mapping[str, str], system: Path = SYSTEM) -> list[Path]:
    """Every key folder of this computer that this user can read, those of the system first."""
    folders = []
    for base in _default_folders(system):
        with suppress(OSError):
            folders += sorted(path for path in base.iterdir() if path.is_dir())
    variable = environment.get(VARIABLE, "")
    return [*([Path(variable)] if variable else []), *folders]


def _default_folders(system: Path) -> list[Path]:
    """The folders that are searched when none is named; for a user without a home only that of the system."""
    with suppress(NoHomeFolder, OutputFileError):
        return [system, config_dir() / "keys"]
    return [system]


def authority_folder(environment: Mapping[str, str]) -> Path:
    """The usual folder of the CA. Raises NoHomeFolder."""
    value = environment.get(AUTHORITY_VARIABLE, "")
    return Path(value) if value else config_dir() / "authority"


def read_keys(folder: Path, holder: Holder) -> Keys:
    """Read the keys in a folder. Raises KeysError, which names the file and the remedy.

    Whether they match each other is checked by `certificate_reader.verify_keys`.
    """
    return Keys(
        holder,
        read_file(folder / AUTHORITY, MAX_PEM),
        read_file(folder / certificate_name(holder), MAX_PEM),
        read_file(folder / key_name(holder), MAX_PEM, secret=True),
        read_crl(folder, needed=holder == "host"),
    )


def read_crl(folder: Path, *, needed: bool = False) -> bytes:
    """The revocation list of a folder; empty if there is none. Raises KeysError, also if it is `needed`.

    A host's folder always has a list: without one, a truncated copy would accept revoked certificates.
    """
    return read_file(folder / REVOKED, MAX_LIST, needed=needed)


def read_trusted(folder: Path) -> bytes:
    """The CA certificate in a key folder of any kind. Raises KeysError."""
    return read_file(folder / AUTHORITY, MAX_PEM)


def read_secret(path: Path) -> bytes:
    """A private key. Raises KeysError, also if other users can read it."""
    return read_file(path, MAX_PEM, secret=True)


@contextmanager
def errors_in(path: Path) -> Iterator[None]:
    """Convert errors about the contents of a file or folder to KeysErrors that name it."""
    try:
        yield
    except KeysError as error:
        raise KeysError(f"{path}: {error}") from None


def write_keys(folder: Path, keys: Keys) -> None:
    """Write keys, each file atomically; creates the folder. Raises OutputFileError.

    Without a private key (`keys.key` empty) the existing one stays.
    """
    if keys.key:
        write_private(folder / key_name(keys.holder), keys.key, 0o600, durable=True)
    write_private(folder / certificate_name(keys.holder), keys.certificate, 0o644, durable=True)
    write_private(folder / AUTHORITY, keys.authority, 0o644, durable=True)
    if keys.revoked:
        write_crl(folder, keys.revoked)


def write_crl(folder: Path, revoked: bytes) -> None:
    """Replace the revocation list. Raises OutputFileError."""
    write_private(folder / REVOKED, revoked, 0o644, durable=True)


def entry_name(name: str) -> str:
    """The folder name of a host: names in a deployment may contain dots, and must not leave the key
    folder."""
    return f"_{name}" if name.startswith(".") else name


def _entry_path(base: Path, name: str) -> Path:
    return base / entry_name(name)


def read_file(path: Path, max_bytes: int, *, secret: bool = False, needed: bool = True) -> bytes:
    """A file of at most `max_bytes` in a key folder. Raises KeysError.

    Also if other users can read a `secret` file; a missing file that is not `needed` is empty.
    """
    try:
        data = read_private(
            Path(os.path.realpath(path.parent), path.name), max_bytes, _owners(), secret=secret
        )
    except FileNotFoundError:
        if not needed:
            return b""
        raise KeysError(f"{path} is not there: copy the folder again from where its authority is") from None
    except OSError as error:
        raise KeysError(f"{path} cannot be used: {_reason(error)}") from None
    if not data:
        # An empty list would mean that no certificate is revoked.
        raise KeysError(
            f"{path} is empty: it was cut short when it was copied; copy it again from where its authority is"
        )
    return data


def _owners() -> tuple[int, int]:
    """The user who runs the host, and root."""
    return os.geteuid(), 0


def _reason(error: OSError) -> str:
    if error.errno == errno.ELOOP:
        return "it is a link; copy the file itself"
    if error.errno == errno.EACCES:
        return "this user may not read it; its owner is who runs the host, or root"
    return error.strerror or str(error)
