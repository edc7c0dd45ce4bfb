"""Files on the vehicle (its SD card), for programs."""

from __future__ import annotations

from lfield_mavlink.services import Services

#: Bytes of the largest file that becomes a string of a program.
MAX_TEXT = 256 * 1024


class Files(Services):
    """Listing, reading and writing, beside whatever the vehicle does."""

    async def do_list_files(self, path: str) -> str:
        """What is in a folder, a name per line; folders end in `/`."""
        entries = await self._files.list_folder(path)
        return "\n".join(entry.name + ("/" if entry.folder else "") for entry in entries)

    async def do_read_file(self, path: str) -> str:
        """The text in a file."""
        data = await self._files.read(path, MAX_TEXT)
        try:
            return data.decode()
        except UnicodeDecodeError:
            raise self.error(f"readFile: {path} holds {len(data)} bytes that are not text (UTF-8)") from None

    async def do_write_file(self, path: str, text: str) -> None:
        """Make a file with a text in it, or replace one."""
        data = text.encode()
        if len(data) > MAX_TEXT:
            raise self.error(f"writeFile: {len(data)} bytes are more than the {MAX_TEXT} that may be")
        await self._files.write(path, data)

    async def do_remove_file(self, path: str) -> None:
        """Remove a file."""
        await self._files.remove(path)

    async def do_make_folder(self, path: str) -> None:
        """Make a folder."""
        await self._files.make_folder(path)
