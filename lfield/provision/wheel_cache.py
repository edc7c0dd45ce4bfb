"""Wheels for robots on the desk: `~/.cache/lfield/wheels/ARCH-PYTHON`, collected from the package index.

    aarch64-cp311/*.whl
    aarch64-cp311/lock-DIGEST.json     the wheels of one lock file, with their SHA-256 and sizes

A collection that is listed there is complete, and is checked against its digests whenever it is used. pip
compares each file with the hashes of the lock file; a wheel that was made by hand has none there.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from lfield import __version__
from lfield.errors import ProvisionError
from lfield.provision.installation import Payload, StandalonePython
from lfield.provision.lock_file import Pin, Wheel, needed_pins, normalized, pip_lock, read_lock, text_digest
from lfield.provision.own_wheel import deployment_file, describe_wheel, make_own_wheel, run_pip
from lfield.provision.standalone_python import collect_python
from lfield.provision.wheel_target import WheelTarget

LOCK = "locks/run.txt"
#: The package of the lock that only robots in a Zenoh fabric need.
ZENOH = "eclipse-zenoh"


class WheelCollection(msgspec.Struct, frozen=True):
    """The wheels of a lock file for one platform."""

    wheels: tuple[Wheel, ...]


class WheelCache:
    """The wheels of all platforms; `handmade` is a folder with wheels that the package index does not have.

    Each platform is collected once, also when several robots need it at the same time. `has_zenoh` is true if
    the robots are in a Zenoh fabric.
    """

    def __init__(self, folder: Path, handmade: Path | None = None, *, has_zenoh: bool = False) -> None:
        self._folder, self._handmade = folder, handmade
        pins = read_lock(deployment_file(LOCK).decode(), f"deploy/{LOCK}")
        self._lock = [pin for pin in pins if has_zenoh or pin.name != ZENOH]
        self._payloads: dict[tuple[WheelTarget, bool], asyncio.Task[Payload]] = {}
        self._own: asyncio.Task[Path] | None = None
        folder.mkdir(parents=True, exist_ok=True)
        self._temporary = tempfile.TemporaryDirectory(prefix=".own-wheel-", dir=folder)

    def close(self) -> None:
        """Remove temporary files."""
        self._temporary.cleanup()

    async def payload(self, target: WheelTarget, *, brings_python: bool) -> Payload:
        """All files that robots of a platform need; collects missing ones. Raises ProvisionError."""
        key = (target, brings_python)
        if key not in self._payloads:
            self._payloads[key] = asyncio.create_task(self._collect(target, brings_python))
        return await asyncio.shield(self._payloads[key])

    async def _collect(self, target: WheelTarget, brings_python: bool) -> Payload:
        if self._own is None:
            self._own = asyncio.create_task(make_own_wheel(Path(self._temporary.name)))
        own = await self._own
        folder = self._folder / "wheels" / str(target)
        wheels = await self._wheels(target, folder)
        python: StandalonePython | None = None
        if brings_python:
            python = await collect_python(self._folder / "python", target)
        described = (*wheels, describe_wheel(own))
        return Payload(__version__, described, folder, own, python)

    async def _wheels(self, target: WheelTarget, folder: Path) -> tuple[Wheel, ...]:
        pins = needed_pins(self._lock, target)
        index = folder / f"lock-{text_digest(pip_lock(pins))}.json"
        collection = _read_collection(index)
        if collection is not None:
            return collection.wheels
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as new:
            handmade = list(self._handmade_wheels(pins, target))
            for path in handmade:
                shutil.copyfile(path, Path(new, path.name))
            missing = [pin for pin in pins if not any(pin.is_wheel(path.name) for path in handmade)]
            await _download(missing, target, Path(new))
            found = tuple(describe_wheel(path) for path in sorted(Path(new).glob("*.whl")))
            for wheel in found:
                os.replace(Path(new, wheel.file), folder / wheel.file)
            temporary = Path(new, index.name)
            temporary.write_bytes(msgspec.json.encode(WheelCollection(found)))
            os.replace(temporary, index)
        return found

    def _handmade_wheels(self, pins: Sequence[Pin], target: WheelTarget) -> Iterable[Path]:
        for path in sorted(self._handmade.glob("*.whl")) if self._handmade else ():
            if target.accepts(path.name) and any(pin.is_wheel(path.name) for pin in pins):
                yield path


def _read_collection(index: Path) -> WheelCollection | None:
    """A collection with all files present and unchanged."""
    with suppress(OSError, msgspec.DecodeError):
        collection = msgspec.json.decode(index.read_bytes(), type=WheelCollection)
        files = ((index.with_name(wheel.file), wheel.sha256) for wheel in collection.wheels)
        if all(hashlib.sha256(path.read_bytes()).hexdigest() == digest for path, digest in files):
            return collection
    return None


async def _download(pins: Sequence[Pin], target: WheelTarget, folder: Path) -> None:
    """Collect wheels. Raises ProvisionError, which names every package that has none."""
    if not pins:
        return
    try:
        await _pip_download(pins, target, folder)
    except ProvisionError as error:
        missing = [pin for pin in pins if not await _is_available(pin, target, folder)]
        if not missing or len(missing) == len(pins):
            advice = "--prepare needs access to the package index; robots do not"
            raise ProvisionError(
                "", f"wheels for {target} cannot be collected: {error.reason}", advice
            ) from None
        names = " ".join(map(str, missing))
        build = f"on such a robot: pip wheel --no-deps -w wheels {names}"
        raise ProvisionError(
            "", f"the package index has no wheels for {target} of {names}", f"{build}; then --wheels DIR"
        ) from None


async def _is_available(pin: Pin, target: WheelTarget, folder: Path) -> bool:
    try:
        await _pip_download([pin], target, folder)
    except ProvisionError:
        return False
    return True


async def _pip_download(pins: Sequence[Pin], target: WheelTarget, folder: Path) -> None:
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as lock:
        lock.write(pip_lock(pins))
        lock.flush()
        await run_pip(
            *("download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:"),
            *("--require-hashes", *target.pip_options(), "-d", str(folder), "-r", lock.name),
            operation="pip download",
        )
    names = {normalized(path.name.partition("-")[0]) for path in folder.glob("*.whl")}
    if missing := [str(pin) for pin in pins if normalized(pin.name) not in names]:
        raise ProvisionError("", f"pip has not collected {' '.join(missing)}")
