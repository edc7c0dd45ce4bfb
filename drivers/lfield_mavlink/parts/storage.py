"""The autopilot's stored data for programs: parameters, and files on its card."""

from __future__ import annotations

from collections.abc import Callable

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.services.file_transfer import FileTransfer
from lfield_mavlink.services.parameters import Parameters

#: ArduPilot's binary file of all parameters.
PACKED = "@PARAM/param.pck"
#: Bytes of the largest file that a program may read as a string.
MAX_TEXT = 256 * 1024


class Settings:
    """Reads and writes parameters by name; `protects` returns whether the binding requires one unchanged."""

    def __init__(self, vehicle: Contact, parameters: Parameters, protects: Callable[[str], bool]) -> None:
        self._vehicle, self._parameters, self._protects = vehicle, parameters, protects

    async def do_parameter(self, name: str) -> float:
        """The value of a parameter, also for integers."""
        value = await self._parameters.read(name)
        if value is None:
            raise self._parameters.unknown(name)
        return float(value)

    async def do_set_parameter(self, name: str, value: float) -> None:
        """Sets a parameter; done when the autopilot has reported the new value."""
        if self._protects(name):
            raise self._vehicle.error(
                f"setParameter refused: its binding requires {name}; change the binding, then run 'lfield "
                "setup'"
            )
        await self._parameters.write(name, value)

    async def do_parameters(self) -> str:
        """All parameters, sorted, one per line: `NAME VALUE`."""
        values = await self._parameters.read_all()
        return "\n".join(f"{name} {value:.9g}" for name, value in sorted(values.items()))


class Files:
    """Files on the autopilot's card; independent of the vehicle's motion."""

    def __init__(self, vehicle: Contact, files: FileTransfer) -> None:
        self._vehicle, self._files = vehicle, files

    async def do_list_files(self, path: str) -> str:
        """The entries of a folder, one per line; folders end in `/`."""
        entries = await self._files.list_folder(path)
        return "\n".join(entry.name + ("/" if entry.folder else "") for entry in entries)

    async def do_read_file(self, path: str) -> str:
        """The text of a file."""
        data = await self._files.read(path, MAX_TEXT)
        try:
            return data.decode()
        except UnicodeDecodeError:
            hint = "; parameters() returns its contents" if path.startswith(PACKED) else ""
            raise self._vehicle.error(
                f"readFile: {path} contains {len(data)} bytes that are not text (UTF-8){hint}"
            ) from None

    async def do_write_file(self, path: str, text: str) -> None:
        """Writes a text file, replacing an existing one."""
        data = text.encode()
        if len(data) > MAX_TEXT:
            raise self._vehicle.error(f"writeFile: {len(data)} bytes exceed the limit of {MAX_TEXT}")
        await self._files.write(path, data)

    async def do_remove_file(self, path: str) -> None:
        await self._files.remove(path)

    async def do_make_folder(self, path: str) -> None:
        """Creates a folder."""
        await self._files.make_folder(path)
