"""A Python for robots whose own is too old: a standalone build that uv collects on the desk.

uv selects the build by platform, downloads it and verifies its digest. Its settings apply, so that a desk
without internet access can have a mirror: UV_PYTHON_INSTALL_MIRROR, UV_PYTHON_DOWNLOADS_JSON_URL. The build
is packed into `~/.cache/lfield/python/ARCH-VERSION.tar.gz`.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import re
import shutil
import sys
import tarfile
import tempfile
from asyncio.subprocess import DEVNULL
from pathlib import Path

from lfield.errors import ProvisionError
from lfield.event_loop import run_process
from lfield.provision.installation import StandalonePython
from lfield.provision.wheel_target import ARCHITECTURES, WheelTarget


async def collect_python(folder: Path, target: WheelTarget) -> StandalonePython:
    """The standalone Python for a platform, from the cache or through uv. Raises ProvisionError."""
    folder.mkdir(parents=True, exist_ok=True)
    found = sorted(folder.glob(f"{target.arch}-{target.python}.*.tar.gz"), key=_patch)
    return _described(found[-1], target) if found else await _install(folder, target)


def _patch(archive: Path) -> int:
    match = re.search(r"\.(\d+)\.tar\.gz$", archive.name)
    return int(match[1]) if match else -1


def _described(archive: Path, target: WheelTarget) -> StandalonePython:
    data = archive.read_bytes()
    version = archive.name.removeprefix(f"{target.arch}-").removesuffix(".tar.gz")
    return StandalonePython(version, archive, hashlib.sha256(data).hexdigest(), len(data))


def find_uv() -> str | None:
    """The path of uv: that of this environment, or of the user."""
    own = Path(sys.executable).with_name("uv")
    return str(own) if own.is_file() else shutil.which("uv")


async def _install(folder: Path, target: WheelTarget) -> StandalonePython:
    arch, libc = ARCHITECTURES[target.arch]
    key = f"cpython-{target.python}-linux-{arch}-{libc}"
    with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as new:
        await _run_uv(key, new)
        # uv adds links with shorter names.
        builds = [path for path in Path(new).glob("cpython-*") if path.is_dir() and not path.is_symlink()]
        versions = [match[1] for path in builds if (match := re.match(r"cpython-(\d+\.\d+\.\d+)", path.name))]
        if not versions:
            raise ProvisionError("", f"uv has installed no {key}")
        archive = Path(new, "python.tar.gz")
        await asyncio.to_thread(_pack, builds[0], archive)
        place = folder / f"{target.arch}-{versions[0]}.tar.gz"
        os.replace(archive, place)
    return _described(place, target)


async def _run_uv(key: str, folder: str) -> None:
    arguments = ("python", "install", "--no-config", "--no-bin", "--install-dir", folder, key)
    uv = find_uv()
    if uv is None:
        reason = "a robot needs a standalone Python, and there is no uv on this desk"
        raise ProvisionError("", reason, "pip install uv")
    status, _, errors = await run_process(uv, *arguments, stdout=DEVNULL)
    if status:
        # Earlier lines are progress.
        reason = " ".join(errors.decode(errors="replace").rpartition("error: ")[2].split())
        advice = "--prepare needs access to the internet, or UV_PYTHON_INSTALL_MIRROR=URL"
        raise ProvisionError("", f"the standalone Python {key} cannot be collected: {reason}", advice)


def _pack(build: Path, archive: Path) -> None:
    """The contents of a folder, without bytecode and its owner."""

    def entry(info: tarfile.TarInfo) -> tarfile.TarInfo | None:
        if "__pycache__" in info.name:
            return None
        info.uid = info.gid = 0
        info.uname = info.gname = ""
        return info

    with tarfile.open(archive, "w:gz", compresslevel=6) as tar:
        tar.add(build, ".", filter=entry)
