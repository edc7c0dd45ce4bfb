"""Makes the keys of pages in the folder of an authority:

    browsers.crt  browsers.key      the root for browsers, made with the first page
    pages/192.168.1.20              the keys of a page, by its first name (page_keys.py)

Nothing of it is for hosts. There is no list of pages that count no more, for no browser would ask for one:
certificates of pages are short instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from lfield.authority.folder import read_file
from lfield.authority.keys import MAX_PEM
from lfield.authority.ledger import Ledger
from lfield.authority.pages.browsers import Browsers, new_browsers, read_browsers
from lfield.authority.pages.names import spelled
from lfield.authority.pages.page_keys import PageKeys, page_keys, write_page
from lfield.text.private import write_private

ROOT, ROOT_KEY, PAGES = "browsers.crt", "browsers.key", "pages"


class MadePage(NamedTuple):
    """Keys that were made, the folder that has them, and the file with the root for browsers."""

    keys: PageKeys
    folder: Path
    root: Path


def make_page(ledger: Ledger, names: Sequence[str], at: float, ends: float) -> MadePage:
    """Keys of a page with these addresses and names, from now (`at`) until `ends`.

    They take the place of those that were made for the first of them. Raises KeysError.
    """
    named = tuple(dict.fromkeys(map(spelled, names)))
    found = _root(ledger.folder)
    root = found or new_browsers(at, ledger.authority.ends)
    issued = root.issue(named, at=at, ends=ends)
    if found is None:
        write_private(ledger.folder / ROOT_KEY, root.key, 0o600, durable=True)
        write_private(ledger.folder / ROOT, root.certificate, 0o644, durable=True)
    folder = ledger.folder / PAGES / named[0]
    write_page(folder, issued.certificate, issued.key)
    return MadePage(page_keys(issued.certificate, issued.key), folder, ledger.folder / ROOT)


def _root(folder: Path) -> Browsers | None:
    """The root in the folder of an authority, None before there is one. Raises KeysError."""
    if not (folder / ROOT).exists() and not (folder / ROOT_KEY).exists():
        return None
    return read_browsers(
        read_file(folder / ROOT, MAX_PEM), read_file(folder / ROOT_KEY, MAX_PEM, secret=True)
    )
