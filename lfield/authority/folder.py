"""Key folders: where `up` and the commands find them, and how they are read and written.

From strong to weak, for host alpha and for a person:

    --keys DIR                           DIR itself, or the folder in it of that name
    $LFIELD_KEYS                         the same
    /etc/lfield/keys/alpha               /etc/lfield/keys/me
    ~/.config/lfield/keys/alpha          ~/.config/lfield/keys/me

What is named and is not there is an error; it is never looked for elsewhere then. What is in a folder, and
what the files are called, is in `keys.py`. A folder, or a file in it, that others could write to is not
believed, and a private key that others may read is refused. A link to a folder is followed, as links above it
are: what counts is whose the folder itself is. A file that is a link is not read.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from lfield.authority.keys import (
    AUTHORITY,
    MAX_LIST,
    MAX_PEM,
    REVOKED,
    Holder,
    Keys,
    certificate_name,
    key_name,
)
from lfield.errors import KeysError, NoHome, OutputFileError
from lfield.text.own_folders import lfield_in, own_folder
from lfield.text.private import read_private, write_private

#: The folder of a person's keys, as that of a host has the host's name.
ME = "me"
#: Where a computer keeps the keys of its hosts, and where this variable says so instead.
SYSTEM, VARIABLE = Path("/etc/lfield/keys"), "LFIELD_KEYS"


def own_keys(environment: Mapping[str, str]) -> Path:
    """The folder of this user's keys. Raises NoHome, OutputFileError."""
    return own_settings(environment) / "keys"


def own_settings(environment: Mapping[str, str]) -> Path:
    """The folder of this user's settings of lfield. Raises NoHome, OutputFileError."""
    return lfield_in(own_folder("XDG_CONFIG_HOME", ".config", environment))


def find(
    holder: Holder,
    name: str,
    named: Path | None,
    environment: Mapping[str, str],
    system: Path = SYSTEM,
) -> Path | None:
    """The folder with the keys of a host (`name`), or of this user (`ME`); None where there is none.

    `named` is what --keys said. Raises KeysError where a folder was named and has no such keys.
    """
    said = named or (Path(environment[VARIABLE]) if environment.get(VARIABLE) else None)
    usual = [_inside(base, name) for base in _usual(environment, system)]
    for folder in (said, _inside(said, name)) if said is not None else usual:
        # What this user may not look into is not there.
        if os.path.exists(folder / certificate_name(holder)):
            return folder
    if said is not None:
        whose = f"host {name}" if holder == "host" else "a person"
        raise KeysError(
            f"{said} has no keys of {whose} that this user may see ({certificate_name(holder)}): copy there "
            f"what 'lfield keys {holder}' has made"
        )
    return None


def folders_here(environment: Mapping[str, str], system: Path = SYSTEM) -> list[Path]:
    """Every key folder of this computer that this user may see, those of the system first."""
    found = []
    for base in _usual(environment, system):
        with suppress(OSError):
            found += sorted(path for path in base.iterdir() if path.is_dir())
    said = environment.get(VARIABLE, "")
    return [*([Path(said)] if said else []), *found]


def _usual(environment: Mapping[str, str], system: Path) -> list[Path]:
    """The folders of keys where none is named. A user without a folder of their own has the system's only."""
    with suppress(NoHome, OutputFileError):
        return [system, own_keys(environment)]
    return [system]


def read(folder: Path, holder: Holder) -> Keys:
    """The keys in a folder. Raises KeysError, which names the file and what to do.

    Whether they fit one another is not looked at here (`reading.checked`).
    """
    return Keys(
        holder,
        read_file(folder / AUTHORITY, MAX_PEM),
        read_file(folder / certificate_name(holder), MAX_PEM),
        read_file(folder / key_name(holder), MAX_PEM, secret=True),
        read_list(folder, needed=holder == "host"),
    )


def read_list(folder: Path, *, needed: bool = False) -> bytes:
    """The revocation list of a folder; empty where there is none. Raises KeysError, also when it is `needed`.

    A host's folder has one from the beginning: a copy that was cut short would believe whoever is revoked.
    """
    return read_file(folder / REVOKED, MAX_LIST, needed=needed)


def read_trusted(folder: Path) -> bytes:
    """The certificate of the authority in a folder, which may be any of them. Raises KeysError."""
    return read_file(folder / AUTHORITY, MAX_PEM)


def read_secret(path: Path) -> bytes:
    """A private key. Raises KeysError, also when others may read it."""
    return read_file(path, MAX_PEM, secret=True)


@contextmanager
def of(path: Path) -> Iterator[None]:
    """Whatever is wrong meanwhile with what a file says, or those of a folder, names it: a KeysError."""
    try:
        yield
    except KeysError as error:
        raise KeysError(f"{path}: {error}") from None


def write(folder: Path, keys: Keys) -> None:
    """Write them, each file whole or not at all; the folder is made if there is none. Raises OutputFileError.

    Without a private key (`keys.key` empty) the one that is there stays.
    """
    if keys.key:
        write_private(folder / key_name(keys.holder), keys.key, 0o600, durable=True)
    write_private(folder / certificate_name(keys.holder), keys.certificate, 0o644, durable=True)
    write_private(folder / AUTHORITY, keys.authority, 0o644, durable=True)
    if keys.revoked:
        write_list(folder, keys.revoked)


def write_list(folder: Path, revoked: bytes) -> None:
    """Put a revocation list in the place of the one that is there. Raises OutputFileError."""
    write_private(folder / REVOKED, revoked, 0o644, durable=True)


def inside_name(name: str) -> str:
    """What the folder of a host is called; names of deployments may have dots, and none leads out of it."""
    return f"_{name}" if name.startswith(".") else name


def _inside(base: Path, name: str) -> Path:
    return base / inside_name(name)


def read_file(path: Path, most: int, *, secret: bool = False, needed: bool = True) -> bytes:
    """A file of at most so many bytes in a key folder. Raises KeysError.

    Also when others may read what is `secret`; what is not `needed` and not there is empty.
    """
    try:
        data = read_private(Path(os.path.realpath(path.parent), path.name), most, _owners(), secret=secret)
    except FileNotFoundError:
        if not needed:
            return b""
        raise KeysError(f"{path} is not there: copy the folder again from where its authority is") from None
    except OSError as error:
        raise KeysError(f"{path} cannot be used: {_reason(error)}") from None
    if not data:
        # For a list it would mean that nobody is revoked.
        raise KeysError(
            f"{path} is empty: it was cut short when it was copied; copy it again from where its authority is"
        )
    return data


def _owners() -> tuple[int, int]:
    """Whoever runs the host, and root."""
    return os.geteuid(), 0


def _reason(error: OSError) -> str:
    if error.errno == errno.ELOOP:
        return "it is a link; copy the file itself"
    if error.errno == errno.EACCES:
        return "this user may not read it; its owner is who runs the host, or root"
    return error.strerror or str(error)
