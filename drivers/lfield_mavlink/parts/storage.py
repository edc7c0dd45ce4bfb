"""What the autopilot keeps, for programs: its parameters, and the files on its card."""

from __future__ import annotations

from collections.abc import Callable

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.services.file_transfer import FileTransfer
from lfield_mavlink.services.parameters import Parameters

#: ArduPilot's file of all parameters, which is binary.
PACKED = "@PARAM/param.pck"
#: Bytes of the largest file that becomes a string of a program.
MAX_TEXT = 256 * 1024


class Settings:
    """Reading and writing parameters by their names; `protects` says which the binding needs as they are."""

    def __init__(self, vehicle: Contact, parameters: Parameters, protects: Callable[[str], bool]) -> None:
        self._vehicle, self._parameters, self._protects = vehicle, parameters, protects

    async def do_parameter(self, name: str) -> float:
        """The value of a parameter, whole numbers included."""
        value = await self._parameters.read(name)
        if value is None:
            raise self._parameters.unknown(name)
        return float(value)

    async def do_set_parameter(self, name: str, value: float) -> None:
        """Set a parameter; done when the autopilot has told the new value."""
        if self._protects(name):
            raise self._vehicle.error(
                f"setParameter refused: {name} keeps the vehicle within its binding; change the binding, "
                "then run 'lfield setup'"
            )
        await self._parameters.write(name, value)

    async def do_parameters(self) -> str:
        """All of them, sorted, one per line: `NAME VALUE`."""
        found = await self._parameters.read_all()
        return "\n".join(f"{name} {value:.9g}" for name, value in sorted(found.items()))


class Files:
    """The files on its card: listed, read and written, beside whatever the vehicle does."""

    def __init__(self, vehicle: Contact, files: FileTransfer) -> None:
        self._vehicle, self._files = vehicle, files

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
            instead = "; parameters() tells what is in it" if path.startswith(PACKED) else ""
            raise self._vehicle.error(
                f"readFile: {path} holds {len(data)} bytes that are not text (UTF-8){instead}"
            ) from None

    async def do_write_file(self, path: str, text: str) -> None:
        """Make a file with a text in it, or replace one."""
        data = text.encode()
        if len(data) > MAX_TEXT:
            raise self._vehicle.error(
                f"writeFile: {len(data)} bytes are more than the {MAX_TEXT} that may be"
            )
        await self._files.write(path, data)

    async def do_remove_file(self, path: str) -> None:
        """Remove a file."""
        await self._files.remove(path)

    async def do_make_folder(self, path: str) -> None:
        """Make a folder."""
        await self._files.make_folder(path)
