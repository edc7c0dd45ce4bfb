"""The home folder of a desk for the tests: an inventory, an authority, and wheels, without a package index.

The wheels are built from the environment of the tests. There are only those that `lfield doctor` imports, so
that an installation takes seconds. The complete lock file is tested without robots.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from collections.abc import Iterable
from importlib.metadata import distribution
from pathlib import Path

import msgspec

from lfield.provision.lock_file import needed_pins, pip_lock, read_lock, text_digest
from lfield.provision.own_wheel import deployment_file, describe_wheel, repack
from lfield.provision.wheel_cache import LOCK, ZENOH, WheelCollection
from lfield.provision.wheel_target import WheelTarget

#: The imports of lfield without drivers, and pip.
NAMES = (
    *("cffi", "cryptography", "markdown-it-py", "mdurl", "msgspec", "pip", "platformdirs", "pycparser"),
    *("Pygments", "PyYAML", "rich"),
)
#: Variables that name folders of this user. XDG_RUNTIME_DIR is kept: the tests have their own.
_SETTINGS = ("XDG_C", "XDG_D", "XDG_S", "LFIELD_")
LFIELD = Path(sys.executable).with_name("lfield")
PYTHON = f"{sys.version_info[0]}.{sys.version_info[1]}"
#: The Python from which the environment of the tests was made. typeshed does not declare the attribute,
#: which venv uses too.
BASE_PYTHON = Path(sys._base_executable).resolve()  # type: ignore[attr-defined]


class Desk:
    """A home folder with everything that `lfield provision` reads and writes on the desk."""

    def __init__(self, folder: Path) -> None:
        self.home = folder
        self.inventory = folder / "inventory.yaml"
        self.cache = folder / ".cache/lfield"
        self.environment = {
            **{key: value for key, value in os.environ.items() if not key.startswith(_SETTINGS)},
            "HOME": str(folder),
            "PIP_NO_INDEX": "1",
            "COLUMNS": "200",
            # Hides missions of other tests on this computer.
            "LFIELD_RUNS": "here",
        }

    def make_keys(self) -> None:
        """The authority of the team, and the keys of its operator."""
        arguments = [LFIELD, "keys", "init", "--person", "anna"]
        subprocess.run(arguments, env=self.environment, check=True, capture_output=True, timeout=60)

    def write_inventory(self, addresses: dict[str, str], extra: str = "") -> None:
        """An inventory of robots, each with one address; `extra` is added to each host."""
        hosts = "".join(f"  {name}:\n    addresses: [{place}]\n{extra}" for name, place in addresses.items())
        self.inventory.write_text(f"hosts:\n{hosts}")

    def collect_wheels(self, wheels: Path, arch: str = os.uname().machine, python: str = PYTHON) -> None:
        """Fills the cache of a platform with the wheels in the folder `wheels`."""
        target = WheelTarget(arch, python)
        folder = self.cache / "wheels" / str(target)
        folder.mkdir(parents=True, exist_ok=True)
        for path in wheels.glob("*.whl"):
            (folder / path.name).hardlink_to(path)
        lock = [pin for pin in read_lock(deployment_file(LOCK).decode(), LOCK) if pin.name != ZENOH]
        pins = needed_pins(lock, target)
        collection = WheelCollection(tuple(describe_wheel(path) for path in sorted(folder.glob("*.whl"))))
        index = folder / f"lock-{text_digest(pip_lock(pins))}.json"
        index.write_bytes(msgspec.json.encode(collection))

    def collect_python(self, version: str) -> None:
        """A standalone Python of that version: the Python of these tests without unused modules."""
        archive = self.cache / "python" / f"{os.uname().machine}-{version}.tar.gz"
        archive.parent.mkdir(parents=True, exist_ok=True)
        pack_python(archive)

    def provision(self, *arguments: object) -> list[object]:
        """The command line of `lfield provision` with the inventory of this desk."""
        return [LFIELD, "provision", "--inventory", self.inventory, *arguments]


def make_wheels(folder: Path, names: Iterable[str] = NAMES) -> None:
    """Builds wheels from the environment of the tests."""
    for name in names:
        repack(distribution(name), folder)


def pack_python(archive: Path) -> None:
    """The Python of these tests as an archive of a standalone build."""
    base, name = Path(sys.base_prefix), f"python{PYTHON}"
    library = base / "lib" / name
    unused = {"test", "tests", "idlelib", "tkinter", "site-packages", "__pycache__", "lib2to3", "turtledemo"}

    def entry(info: tarfile.TarInfo) -> tarfile.TarInfo | None:
        parts = set(Path(info.name).parts)
        return None if parts & unused or any(part.startswith("config-") for part in parts) else info

    with tarfile.open(archive, "w:gz", compresslevel=1) as tar:
        tar.add(BASE_PYTHON, f"bin/{name}")
        link = tarfile.TarInfo("bin/python3")
        link.type, link.linkname = tarfile.SYMTYPE, name
        tar.addfile(link)
        tar.add(library, f"lib/{name}", filter=entry)
        for shared in base.glob(f"lib/libpython{PYTHON}*.so*"):
            tar.add(shared, f"lib/{shared.name}")
