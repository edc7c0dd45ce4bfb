"""Makes the keys of web pages in the folder of a CA:

    browsers.crt  browsers.key      the root CA for browsers, made with the first page
    pages/192.168.1.20              the keys of a page, by its first name (web_keys.py)

Hosts use none of these. There is no revocation list for pages, because browsers would not request one:
their certificates have a short validity instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from lfield.authority.key_material import MAX_PEM
from lfield.authority.keystore import read_file
from lfield.authority.ledger import Ledger
from lfield.authority.web_ca.browser_ca import BrowserCa, new_browser_ca, read_browser_ca
from lfield.authority.web_ca.web_keys import WebKeys, parse_web_keys, write_web_keys
from lfield.authority.web_ca.web_names import normalised
from lfield.text.secure_files import write_private

ROOT, ROOT_KEY, WEB_FOLDER = "browsers.crt", "browsers.key", "pages"


class IssuedWebKeys(NamedTuple):
    """Keys that were made, their folder, and the file with the root CA for browsers."""

    keys: WebKeys
    folder: Path
    root: Path


def issue_web_keys(ledger: Ledger, names: Sequence[str], at: float, ends: float) -> IssuedWebKeys:
    """Make the keys of a page with these addresses and names, valid from now (`at`) until `ends`.

    The keys replace earlier ones for the first of the names. Raises KeysError.
    """
    named = tuple(dict.fromkeys(map(normalised, names)))
    found = _read_root(ledger.folder)
    root = found or new_browser_ca(at, ledger.authority.valid_until)
    issued = root.issue(named, at=at, ends=ends)
    if found is None:
        write_private(ledger.folder / ROOT_KEY, root.key, 0o600, durable=True)
        write_private(ledger.folder / ROOT, root.certificate, 0o644, durable=True)
    folder = ledger.folder / WEB_FOLDER / named[0]
    write_web_keys(folder, issued.certificate, issued.key)
    return IssuedWebKeys(parse_web_keys(issued.certificate, issued.key), folder, ledger.folder / ROOT)


def _read_root(folder: Path) -> BrowserCa | None:
    """The root in the folder of a CA; None if there is none yet. Raises KeysError."""
    if not (folder / ROOT).exists() and not (folder / ROOT_KEY).exists():
        return None
    return read_browser_ca(
        read_file(folder / ROOT, MAX_PEM), read_file(folder / ROOT_KEY, MAX_PEM, secret=True)
    )
