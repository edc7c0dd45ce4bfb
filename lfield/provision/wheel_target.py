"""The platform for which wheels are collected: architecture and version of Python (PEP 425, 600, 508)."""

from __future__ import annotations

import re
from collections.abc import Iterator

from msgspec import Struct

#: Architectures with their name in the keys of uv's Pythons, and the C library there.
ARCHITECTURES = {
    "aarch64": ("aarch64", "gnu"),
    "armv7l": ("armv7", "gnueabihf"),
    "x86_64": ("x86_64", "gnu"),
}
#: The Pythons for which the dependencies have wheels, the preferred first.
PYTHONS = ("3.13", "3.12", "3.11")
#: Wheels for glibc 2.17 to 2.31 are accepted: all supported systems have that of Ubuntu 20.04 at least.
_MANYLINUX_MINORS = range(17, 32)
MIN_GLIBC = (2, 31)
#: The first names of manylinux, which wheels for x86_64 still have.
_OLD_NAMES = ("manylinux2014", "manylinux2010", "manylinux1")


class WheelTarget(Struct, frozen=True, order=True):
    """An architecture as of `uname -m`, and a Python such as 3.11."""

    arch: str
    python: str

    def __str__(self) -> str:
        return f"{self.arch}-cp{self.python.replace('.', '')}"

    def pip_options(self) -> Iterator[str]:
        """The options of `pip download` that select wheels for this platform."""
        for minor in reversed(_MANYLINUX_MINORS):
            yield from ("--platform", f"manylinux_2_{minor}_{self.arch}")
        for name in _OLD_NAMES:
            yield from ("--platform", f"{name}_{self.arch}")
        yield from ("--platform", f"linux_{self.arch}", "--implementation", "cp")
        yield from ("--python-version", self.python)
        for abi in (f"cp{self.python.replace('.', '')}", "abi3", "none"):
            yield from ("--abi", abi)

    def environment(self) -> dict[str, str]:
        """The values of environment markers (PEP 508); pip evaluates those of its own Python."""
        return {
            "implementation_name": "cpython",
            "implementation_version": f"{self.python}.0",
            "os_name": "posix",
            "platform_machine": self.arch,
            "platform_python_implementation": "CPython",
            "platform_release": "",
            "platform_system": "Linux",
            "platform_version": "",
            "python_full_version": f"{self.python}.0",
            "python_version": self.python,
            "sys_platform": "linux",
        }

    def accepts(self, wheel: str) -> bool:
        """Whether a wheel of that file name may be for this platform, for wheels that were made by hand."""
        match = re.fullmatch(r".+-([^-]+)-([^-]+)-([^-]+)\.whl", wheel)
        if match is None:
            return False
        python, abi, platform = (set(part.split(".")) for part in match.groups())
        own = f"cp{self.python.replace('.', '')}"
        fits_python = own in python or "py3" in python or ("abi3" in abi and _is_older(python, own))
        return fits_python and any(tag == "any" or tag.endswith(f"_{self.arch}") for tag in platform)


def _is_older(tags: set[str], own: str) -> bool:
    numbers = [int(tag[3:]) for tag in tags if re.fullmatch(r"cp3\d+", tag)]
    return any(number <= int(own[3:]) for number in numbers)
