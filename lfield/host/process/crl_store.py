"""Storage of a host's revocation list: read at the start, written when a newer revocation arrives.

A failed write is retried until it succeeds: a host that loses a list would accept revoked certificates.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path

from lfield.authority import keystore
from lfield.authority.key_material import REVOKED, Keys
from lfield.authority.peer_verification import NONE_REVOKED, RevocationList
from lfield.errors import OutputFileError
from lfield.event_loop import spawn

#: Seconds until a failed write is retried.
RETRY_AFTER = 1.0


def newest_crl(keys: Keys, folders: Sequence[Path]) -> tuple[RevocationList, bytes]:
    """The list with the highest number of the keys and these folders, with all certificates that any of them
    revokes.

    Raises KeysError.
    """
    # The parser is large, and is loaded before any device moves: a list that arrives in flight must not cause
    # a stall.
    from lfield.authority.certificate_reader import revoked_in

    read = [(revoked_in(keys.revoked, keys.authority), keys.revoked)] if keys.revoked else []
    for place in folders:
        if data := keystore.read_crl(place):
            with keystore.errors_in(place / REVOKED):
                read.append((revoked_in(data, keys.authority), data))
    if not read:
        return NONE_REVOKED, b""
    newest, data = max(read, key=lambda found: found[0].number)
    return reduce(RevocationList.merged, (found for found, _ in read), newest), data


class CrlStore:
    """Stores the newest list of a host for its next start, in the first writable one of these folders.

    The key folder of a service is not writable for the host.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = folders
        self._data = b""
        self._work: asyncio.Task[None] | None = None

    def store(self, data: bytes, on_stored: Callable[[str], None]) -> None:
        """Write a list in the background; `on_stored` gets '' or the failure after each attempt."""
        self._data = data
        if self._work is None or self._work.done():
            self._work = spawn(self._write(on_stored))

    async def _write(self, on_stored: Callable[[str], None]) -> None:
        written = b""
        while written != self._data:
            data = self._data
            reason = await asyncio.to_thread(write_crl, self._folders, data)
            on_stored(reason)
            if reason:
                await asyncio.sleep(RETRY_AFTER)
            else:
                written = data


def write_crl(folders: Sequence[Path], data: bytes) -> str:
    """Write a list into the first writable folder; returns the reasons of the failures, '' for success."""
    failures = []
    for place in folders:
        try:
            keystore.write_crl(place, data)
            return ""
        except OutputFileError as error:
            failures.append(str(error))
    return ", and ".join(failures)
