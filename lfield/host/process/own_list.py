"""Where a host keeps its revocation list: read at its beginning, and written whenever a newer one comes.

What cannot be written is tried again until it can: who forgets a list believes whom it revokes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

from lfield.authority import folder
from lfield.authority.admission import Judged
from lfield.authority.judge import NOBODY, Revoked
from lfield.authority.keys import REVOKED, Keys
from lfield.errors import OutputFileError
from lfield.loop import spawn

#: Seconds after which a list that could not be kept is tried again.
AGAIN = 1.0


def newest_list(keys: Keys, folders: Sequence[Path]) -> tuple[Revoked, bytes]:
    """The list with the highest number, of the keys and of these folders, with what any of them revokes.

    Raises KeysError.
    """
    # Large, and loaded before anything moves: a list may come in flight, and nothing must stand still for it.
    from lfield.authority.reading import revoked_in

    read = [(revoked_in(keys.revoked, keys.authority), keys.revoked)] if keys.revoked else []
    for place in folders:
        if data := folder.read_list(place):
            with folder.of(place / REVOKED):
                read.append((revoked_in(data, keys.authority), data))
    if not read:
        return NOBODY, b""
    newest, data = max(read, key=lambda found: found[0].number)
    return reduce(Revoked.united, (found for found, _ in read), newest), data


class ListKeeper:
    """Keeps the newest list of a host for its next life, in the first of these folders that lets it.

    `admission` is told of what is not kept. Who has keys of a service may not write to their folder.
    """

    def __init__(self, folders: Sequence[Path], admission: Judged) -> None:
        self._folders, self._admission = folders, admission
        self._data = b""
        self._work: asyncio.Task[None] | None = None

    def keep(self, data: bytes) -> None:
        """Have a list written: a disk may take its time, and the host has none."""
        self._data = data
        if self._work is None or self._work.done():
            self._work = spawn(self._write())

    async def _write(self) -> None:
        written = b""
        while written != self._data:
            data = self._data
            why = await asyncio.to_thread(keep_list, self._folders, data)
            self._admission.kept(why)
            if why:
                await asyncio.sleep(AGAIN)
            else:
                written = data


def keep_list(folders: Sequence[Path], data: bytes) -> str:
    """Write a list into the first folder that lets it; why none does, '' when one did or there is none."""
    failures = []
    for place in folders:
        try:
            folder.write_list(place, data)
            return ""
        except OutputFileError as error:
            failures.append(str(error))
    return ", and ".join(failures)
