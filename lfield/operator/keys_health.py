"""Whether the keys in a folder can be used, and for how long: for `lfield doctor` and `lfield keys show`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from lfield.authority import folder as folders
from lfield.authority.identity import Identity, in_order
from lfield.authority.judge import Revoked, when
from lfield.authority.keys import PAGE, Holder, Keys, certificate_name
from lfield.errors import KeysError
from lfield.operator.doctor import Finding

#: So many seconds before their end somebody should renew them.
SOON = 30 * 86400.0
_HOLDERS: tuple[Holder, ...] = ("host", "person")


def keys_here(environment: Mapping[str, str], at: float, system: Path = folders.SYSTEM) -> Iterator[Finding]:
    """The same of all keys of this computer, as far as this user may look; a note where there are none."""
    found = folders.folders_here(environment, system)
    for folder in found:
        yield from health(folder, at)
    if not found:
        yield Finding(
            "note",
            "there are no keys here: no host of this computer listens to others",
            "'lfield keys init' on the operator's computer, or copy a key folder here",
        )


def health(folder: Path, at: float) -> Iterator[Finding]:
    """What is to be said of the keys in a folder, at this time in seconds since 1970 UTC."""
    holders = [holder for holder in _HOLDERS if (folder / certificate_name(holder)).exists()]
    if (folder / PAGE).exists():
        yield _page(folder, at)
    elif not holders:
        yield Finding("problem", f"keys {folder}: there are none", "copy there what 'lfield keys' has made")
    for holder in holders:
        try:
            keys = folders.read(folder, holder)
            yield _finding(folder, keys, at)
        except KeysError as error:
            # Of a file that cannot be used it names the path.
            place = "keys" if str(folder) in str(error) else f"keys {folder}:"
            yield Finding("problem", f"{place} {error}")


def _page(folder: Path, at: float) -> Finding:
    from lfield.authority.pages.page_keys import read_page

    try:
        page = read_page(folder)
    except KeysError as error:
        return Finding("problem", f"keys {error}")
    if refusal := page.refusal(page.names[0], at):
        return Finding("problem", f"keys {folder}: {refusal}")
    what = f"keys {folder}: a page at {', '.join(page.names)}, "
    if page.ends - at < SOON:
        days, renew = (
            int((page.ends - at) // 86400),
            f"'lfield keys page {' '.join(page.names)}' makes the next",
        )
        return Finding("warning", f"{what}end in {days} days, {when(page.ends)}", renew)
    return Finding("ok", f"{what}until {when(page.ends)}")


def _finding(folder: Path, keys: Keys, at: float) -> Finding:
    """Raises KeysError for keys that do not fit one another."""
    from lfield.authority.reading import checked, revoked_in

    who = checked(keys)
    revoked = revoked_in(keys.revoked, keys.authority) if keys.revoked else Revoked()
    what = f"keys {folder}: {who}, "
    details = list(_details(who, revoked))
    if who.serial in revoked.serials:
        return Finding(
            "problem", f"{what}revoked", f"'lfield keys {who.kind} {who.name}' makes new ones", details
        )
    renew = f"'lfield keys renew {who.kind} {who.name}' where the authority is, and copy the folder again"
    if at >= who.ends:
        return Finding("problem", f"{what}ended {when(who.ends)}", renew, details)
    if at < who.begins:
        cure = f"set the clock of this computer, which says {when(at)}"
        return Finding("warning", f"{what}begin {when(who.begins)}", cure, details)
    if who.ends - at < SOON:
        days = int((who.ends - at) // 86400)
        return Finding("warning", f"{what}end in {days} days, {when(who.ends)}", renew, details)
    return Finding("ok", f"{what}until {when(who.ends)}", "", details)


def _details(who: Identity, revoked: Revoked) -> Iterator[str]:
    yield f"certificate {who.serial[:12]} of the authority {who.authority[:12]}"
    if who.kind == "person":
        yield f"may {in_order(who.may) or 'nothing'}"
    if revoked.number:
        yield f"revoked: {revoked}"
