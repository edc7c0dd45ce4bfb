"""The required installation of a robot: an environment with its wheels, settings, keys and the unit."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import Struct

from lfield.provision.lock_file import Wheel, text_digest
from lfield.provision.robot_facts import KEYS, SERVICE_USER, SETTINGS, UNIT

#: The mode of a private key.
PRIVATE = "600"
#: Access to serial ports; the inventory adds more.
BASE_GROUPS = ("dialout",)


@dataclass(frozen=True, slots=True)
class RobotFile:
    """A small file of a robot with its mode (`640`) and owner (`root:lfield`)."""

    path: str
    #: Not in repr(): it may be a private key.
    data: bytes = field(repr=False)
    mode: str
    owner: str

    @property
    def sha256(self) -> str:
        """The digest of the contents, in hex."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def access(self) -> str:
        """Mode and owner, as in the facts of a robot."""
        return f"{self.mode}:{self.owner}"


class StandalonePython(Struct, frozen=True):
    """A Python that the desk brings: its version, and its archive with SHA-256 and size in bytes."""

    version: str
    archive: Path
    sha256: str
    size: int


class Payload(Struct, frozen=True):
    """The collection of the desk for a platform: wheels, their folder, and a Python if one is needed."""

    version: str
    wheels: tuple[Wheel, ...]
    folder: Path
    #: lfield's own wheel, which is made on the desk and is not in the folder.
    own: Path
    python: StandalonePython | None = None

    @property
    def lock(self) -> str:
        """The lock file for the robot, which accepts exactly these wheels."""
        return "".join(f"{wheel.requirement}\n" for wheel in sorted(self.wheels, key=lambda w: w.file))

    @property
    def environment(self) -> str:
        """The name of the environment: the version of lfield, and a digest of its contents."""
        return f"{self.version}-{text_digest(self.lock)}"

    def path(self, wheel: Wheel) -> Path:
        """The file of a wheel on the desk."""
        return self.own if wheel.file == self.own.name else self.folder / wheel.file


class Installation(Struct, frozen=True):
    """The required installation of host `host` of a team."""

    host: str
    payload: Payload
    groups: frozenset[str]
    settings: tuple[RobotFile, ...]
    unit: RobotFile
    #: Empty if the authority is not on this desk; then the keys of the robot stay.
    keys: tuple[RobotFile, ...]
    keys_folder: str
    #: Whether a robot with keys of another authority or host is taken over.
    takes_over: bool = False

    @property
    def configuration(self) -> str:
        """The digest of all files that the service reads when it starts."""
        files = (*self.settings, *self.keys, self.unit)
        named = sorted(f"{file.path} {file.sha256}\n" for file in files)
        return text_digest(self.payload.environment + "\n" + "".join(named))


def settings_file(name: str, data: bytes) -> RobotFile:
    """A file in /etc/lfield, readable by all."""
    return RobotFile(f"{SETTINGS}/{name}", data, "644", "root:root")


def device_file(name: str, data: bytes) -> RobotFile:
    """A file in /etc/lfield that devices need, readable by the service only: it may be a key."""
    return RobotFile(f"{SETTINGS}/{name}", data, "640", f"root:{SERVICE_USER}")


def unit_file(data: bytes) -> RobotFile:
    """The unit of the service."""
    return RobotFile(UNIT, data, "644", "root:root")


def key_files(folder: str, files: Iterable[tuple[str, bytes, bool]]) -> tuple[RobotFile, ...]:
    """The keys of a host: name, contents, and whether it is the private key, of each file."""
    owner = f"{SERVICE_USER}:{SERVICE_USER}"
    return tuple(
        RobotFile(f"{KEYS}/{folder}/{name}", data, PRIVATE if is_private else "644", owner)
        for name, data, is_private in files
    )
