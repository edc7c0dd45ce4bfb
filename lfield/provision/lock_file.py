"""Lock files of pip: pinned requirements with hashes, and the selection for a platform.

    cffi==2.1.1 ; platform_python_implementation != 'PyPy' \\
        --hash=sha256:...
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable

from msgspec import Struct

from lfield.errors import DamagedFileError, ProvisionError
from lfield.provision.wheel_target import WheelTarget

_PIN = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;]+)\s*(?:;\s*(?P<marker>.*?))?\s*")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")
_SEPARATORS = re.compile(r"[-_.]+")


class Pin(Struct, frozen=True):
    """A requirement of one version; `hashes` are those of all its files, SHA-256 in hex."""

    name: str
    version: str
    marker: str
    hashes: frozenset[str]

    def __str__(self) -> str:
        return f"{self.name}=={self.version}"

    def is_wheel(self, file: str) -> bool:
        """Whether a file name is that of a wheel of this version."""
        name, _, suffix = file.partition("-")
        return (normalized(name), suffix.partition("-")[0]) == (normalized(self.name), self.version)


class Wheel(Struct, frozen=True):
    """A wheel on the desk: its file name, its SHA-256 in hex and its size in bytes."""

    file: str
    sha256: str
    size: int

    @property
    def requirement(self) -> str:
        """The line of a lock file that accepts this file alone."""
        name, version = self.file.split("-")[:2]
        return f"{normalized(name)}=={version} --hash=sha256:{self.sha256}"


def normalized(name: str) -> str:
    """The name of a project as PEP 503 compares it."""
    return _SEPARATORS.sub("-", name).lower()


def read_lock(text: str, path: str) -> list[Pin]:
    """The pins of a lock file. Raises DamagedFileError."""
    pins = []
    for line in text.replace("\\\n", " ").splitlines():
        line = line.partition("#")[0].strip()
        if not line:
            continue
        match = _PIN.fullmatch(line.partition("--hash")[0])
        if match is None:
            raise DamagedFileError(path, f"'{line[:60]}' is no pinned requirement")
        hashes = frozenset(_HASH.findall(line))
        pins.append(Pin(match["name"], match["version"], match["marker"] or "", hashes))
    return pins


def needed_pins(pins: Iterable[Pin], target: WheelTarget) -> list[Pin]:
    """The pins that apply to a platform. Raises ProvisionError without the package `packaging`."""
    try:
        from packaging.markers import Marker
    except ImportError:
        raise ProvisionError(
            "", "the desk has no package 'packaging'", "install lfield[desk] on the desk"
        ) from None
    environment = target.environment()
    return [pin for pin in pins if not pin.marker or Marker(pin.marker).evaluate(environment)]


def pip_lock(pins: Iterable[Pin]) -> str:
    """Pins as a lock file without markers."""
    return "".join(f"{pin}{''.join(f' --hash=sha256:{h}' for h in sorted(pin.hashes))}\n" for pin in pins)


def text_digest(text: str) -> str:
    """The first 12 digits of the SHA-256 of a text, for the name of a result."""
    return hashlib.sha256(text.encode()).hexdigest()[:12]
