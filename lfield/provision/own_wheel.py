"""The wheel of the lfield that runs here, and the files of its deployment: lock file and unit.

In a checkout the wheel is built from the sources. An installed lfield has no sources: its wheel is put
together again from the files that pip has installed, as its RECORD lists them. Both are reproducible: the
same code gives the same bytes.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import sys
import zipfile
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

import lfield
from lfield.errors import InputFileError, ProvisionError
from lfield.event_loop import run_process
from lfield.provision.lock_file import Wheel
from lfield.text.input_files import read_bytes

_PACKAGE = Path(lfield.__file__).parent
#: The time of all files in a wheel, as set by hatchling.
_TIME = (2020, 2, 2, 0, 0, 0)
#: Files of an installation that do not belong to its wheel.
_INSTALLERS = {"INSTALLER", "REQUESTED", "direct_url.json", "RECORD", "uv_build.json", "uv_cache.json"}
_MAX_FILE = 4 << 20


def deployment_file(name: str) -> bytes:
    """A file of deploy/, which is in the checkout, or data of the package of an installed lfield."""
    for folder in (_PACKAGE / "deploy", _PACKAGE.parent / "deploy"):
        if (folder / name).is_file():
            return read_bytes(folder / name, _MAX_FILE)
    raise InputFileError(f"deploy/{name}", "it is neither in this installation nor in its checkout")


def describe_wheel(path: Path) -> Wheel:
    """A wheel with its digest and size. Raises OSError."""
    data = path.read_bytes()
    return Wheel(path.name, hashlib.sha256(data).hexdigest(), len(data))


async def make_own_wheel(folder: Path) -> Path:
    """The wheel of this lfield in a folder. Raises ProvisionError."""
    sources = _sources()
    if sources is None:
        return repack(_installed(), folder)
    isolation = ["--no-build-isolation"] if find_spec("hatchling") else []
    arguments = (
        "wheel",
        "--quiet",
        "--no-deps",
        "--disable-pip-version-check",
        *isolation,
        "-w",
        str(folder),
    )
    await run_pip(*arguments, str(sources), operation="lfield's own wheel cannot be built")
    (wheel,) = folder.glob("lfield-*.whl")
    return wheel


def _sources() -> Path | None:
    """The checkout in which this lfield runs, None for an installed one."""
    folder = _PACKAGE.parent
    return folder if (folder / "pyproject.toml").is_file() and (folder / "deploy").is_dir() else None


def _installed() -> Distribution:
    try:
        return distribution("lfield")
    except PackageNotFoundError:
        raise ProvisionError(
            "", "this lfield was not installed by pip", "install its wheel, or a clone"
        ) from None


def repack(installed: Distribution, folder: Path) -> Path:
    """The wheel from which a pure Python package was installed, without the additions of the installer.

    Raises ProvisionError when files are missing or were changed since.
    """
    name, version = installed.metadata["Name"].replace("-", "_"), installed.version
    path = folder / f"{name}-{version}-{_tag(installed)}.whl"
    record, information = [], ""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for file, data in _contents(installed):
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
            record.append(f"{_quoted(file)},sha256={digest},{len(data)}")
            wheel.writestr(_entry(file), data)
            top = file.partition("/")[0]
            information = top if top.endswith(".dist-info") else information
        record.append(f"{information}/RECORD,,")
        wheel.writestr(_entry(f"{information}/RECORD"), "\n".join(record) + "\n")
    return path


def _entry(file: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(file, _TIME)
    entry.external_attr, entry.compress_type = 0o644 << 16, zipfile.ZIP_DEFLATED
    return entry


def _quoted(file: str) -> str:
    return f'"{file}"' if "," in file else file


def _tag(installed: Distribution) -> str:
    """The tags of the wheel, compressed as in a file name."""
    lines = (installed.read_text("WHEEL") or "").splitlines()
    tags = [line.partition(":")[2].strip().split("-") for line in lines if line.startswith("Tag:")]
    parts = zip(*tags, strict=True)
    return "-".join(".".join(dict.fromkeys(part)) for part in parts) or "py3-none-any"


def _contents(installed: Distribution) -> Iterator[tuple[str, bytes]]:
    """The files of the wheel in a fixed order. Commands and bytecode are made by the installer.

    Reads RECORD itself: `Distribution.files` omits missing files since Python 3.12.
    """
    rows = csv.reader((installed.read_text("RECORD") or "").splitlines())
    for name, recorded in sorted((row[0], row[1]) for row in rows if len(row) > 1):
        file = PurePosixPath(name)
        is_added = file.name in _INSTALLERS and ".dist-info/" in name
        if is_added or name.startswith("..") or "__pycache__" in name or file.suffix == ".pyc":
            continue
        try:
            data = Path(str(installed.locate_file(name))).read_bytes()
        except OSError as error:
            raise ProvisionError(
                "", f"{name} of {installed.name} is missing: {error}", "install it again"
            ) from None
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
        if recorded.startswith("sha256=") and recorded.removeprefix("sha256=").rstrip("=") != digest:
            raise ProvisionError("", f"{name} of {installed.name} was changed", "install it again")
        yield name, data


async def run_pip(*arguments: str, operation: str) -> None:
    """Run the pip of this Python. Raises ProvisionError with the end of its output."""
    status, _, errors = await run_process(sys.executable, "-m", "pip", *arguments)
    message = errors.decode(errors="replace")
    if "No module named pip" in message:
        raise ProvisionError("", "the desk's Python has no pip", f"{sys.executable} -m ensurepip")
    if status:
        lines = [line for line in message.splitlines() if line.startswith("ERROR")] or message.splitlines()
        raise ProvisionError("", f"{operation}: {lines[0].removeprefix('ERROR: ') if lines else status}")
