"""Whether the keys in a folder can be used, and for how long: for `lfield doctor` and `lfield keys show`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from lfield.authority import keystore as folders
from lfield.authority.identity import Identity, sorted_rights
from lfield.authority.key_material import WEB_CERTIFICATE, Holder, Keys, certificate_name
from lfield.authority.peer_verification import RevocationList, format_time
from lfield.errors import KeysError
from lfield.operator.diagnostics import DiagnosticFinding

#: Keys that expire within this time (s) should be renewed.
EXPIRY_WARNING = 30 * 86400.0
_HOLDERS: tuple[Holder, ...] = ("host", "person")


def local_keys_health(
    environment: Mapping[str, str], at: float, system: Path = folders.SYSTEM
) -> Iterator[DiagnosticFinding]:
    """The findings about all keys on this computer that this user may read; a note if there are none."""
    found = folders.local_folders(environment, system)
    for folder in found:
        yield from health(folder, at)
    if not found:
        yield DiagnosticFinding(
            "keys",
            "note",
            "no keys on this computer: its hosts do not listen on a network",
            "run 'lfield keys init' on the operator's computer, or copy a directory with keys to this one",
        )


def health(folder: Path, at: float) -> Iterator[DiagnosticFinding]:
    """The finding about the keys in a directory, at this time in seconds since 1970 UTC."""
    holders = [holder for holder in _HOLDERS if (folder / certificate_name(holder)).exists()]
    if (folder / WEB_CERTIFICATE).exists():
        yield _web_keys(folder, at)
    elif not holders:
        yield DiagnosticFinding(
            "keys",
            "problem",
            f"keys {folder}: not found",
            "copy the files that 'lfield keys' has created there",
        )
    for holder in holders:
        try:
            keys = folders.read_keys(folder, holder)
            yield _finding(folder, keys, at)
        except KeysError as error:
            # The error about an unusable file names its path.
            place = "keys" if str(folder) in str(error) else f"keys {folder}:"
            yield DiagnosticFinding("keys", "problem", f"{place} {error}")


def _web_keys(folder: Path, at: float) -> DiagnosticFinding:
    from lfield.authority.web_ca.web_keys import read_web_keys

    try:
        keys = read_web_keys(folder)
    except KeysError as error:
        return DiagnosticFinding("page-keys", "problem", f"keys {error}")
    if refusal := keys.refusal(keys.names[0], at):
        return DiagnosticFinding("page-keys", "problem", f"keys {folder}: {refusal}")
    summary = f"keys {folder}: a page at {', '.join(keys.names)}, "
    if keys.valid_until - at < EXPIRY_WARNING:
        days, renew = (
            int((keys.valid_until - at) // 86400),
            f"'lfield keys page {' '.join(keys.names)}' makes the next",
        )
        return DiagnosticFinding(
            "page-keys", "warning", f"{summary}expire in {days} days, {format_time(keys.valid_until)}", renew
        )
    return DiagnosticFinding("page-keys", "ok", f"{summary}valid until {format_time(keys.valid_until)}")


def _finding(folder: Path, keys: Keys, at: float) -> DiagnosticFinding:
    """Raises KeysError for keys that do not fit one another."""
    from lfield.authority.certificate_reader import revoked_in, verify_keys

    identity = verify_keys(keys)
    revoked = revoked_in(keys.revoked, keys.authority) if keys.revoked else RevocationList()
    summary = f"keys {folder}: {identity}, "
    details = list(_details(identity, revoked))
    if identity.serial in revoked.serials:
        return DiagnosticFinding(
            "keys",
            "problem",
            f"{summary}revoked",
            f"'lfield keys {identity.kind} {identity.name}' creates new ones",
            details,
        )
    command = f"'lfield keys renew {identity.kind} {identity.name}'"
    renew = f"{command} where the authority is, and copy the folder again"
    if at >= identity.valid_until:
        hint = f"set the clock if it is wrong: it shows {format_time(at)}; else {renew}"
        return DiagnosticFinding(
            "keys", "problem", f"{summary}expired {format_time(identity.valid_until)}", hint, details
        )
    if at < identity.valid_from:
        hint = f"set the clock of this computer, which shows {format_time(at)}"
        return DiagnosticFinding(
            "keys", "warning", f"{summary}not valid before {format_time(identity.valid_from)}", hint, details
        )
    if identity.valid_until - at < EXPIRY_WARNING:
        days = int((identity.valid_until - at) // 86400)
        return DiagnosticFinding(
            "keys",
            "warning",
            f"{summary}expire in {days} days, {format_time(identity.valid_until)}",
            renew,
            details,
        )
    return DiagnosticFinding(
        "keys", "ok", f"{summary}valid until {format_time(identity.valid_until)}", "", details
    )


def _details(identity: Identity, revoked: RevocationList) -> Iterator[str]:
    yield f"certificate {identity.serial[:12]} of the authority {identity.authority[:12]}"
    if identity.kind == "person":
        rights = sorted_rights(identity.may)
        yield f"may {rights}" if rights else "has no rights"
    if revoked.number:
        yield f"revoked: {revoked}"
