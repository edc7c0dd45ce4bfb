"""The state directory of each version of lfield, so that a rollback of lfield finds its own state.

    <base>/version           the version that last ran here
    <base>/lfield-0.4.0/     its state: bundles, votes, journals

A newer version starts with a copy of the state of the version before. An older one continues with the state
that it had before the update. No data can be lost by that: an update, like an activation, requires that all
coordinators have ended.
"""

from __future__ import annotations

import os
import re
import shutil
from contextlib import suppress
from pathlib import Path

from lfield.errors import OutputFileError
from lfield.text.secure_files import private_folder, write_private

_MARKER = "version"
_VERSION = re.compile(r"\d+(\.\d+)*", re.ASCII)
#: Not copied: uploads that are not complete, and space that a journal reserves.
_LEFT_OUT = shutil.ignore_patterns("staging", "host.reserve")


def versioned_state(base: Path, version: str) -> Path:
    """The state directory of `version` below `base`, created if it is missing.

    Raises OutputFileError if it cannot be written.
    """
    own, last = _folder(base, version), _last_version(base)
    try:
        if last and last != version and _folder(base, last).is_dir() and _is_newer(version, last):
            _copy(_folder(base, last), own)
    except (OSError, shutil.Error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OutputFileError(str(own), f"the state of version {last} cannot be copied: {reason}") from None
    private_folder(own)
    if last != version:
        write_private(base / _MARKER, version.encode(), durable=True)
    return own


def _folder(base: Path, version: str) -> Path:
    return base / f"lfield-{version}"


def _last_version(base: Path) -> str:
    """The version that last ran here; '' for none."""
    with suppress(OSError, UnicodeDecodeError):
        return (base / _MARKER).read_text().strip()
    return ""


def _is_newer(version: str, other: str) -> bool:
    return _numbers(version) > _numbers(other)


def _numbers(version: str) -> tuple[int, ...]:
    """The numbers at the beginning of a version: 0.4.1 of 0.4.1.dev3."""
    found = _VERSION.match(version)
    return tuple(map(int, found[0].split("."))) if found else ()


def _copy(source: Path, target: Path) -> None:
    """Copy a directory, so that it is complete or missing after a crash; an earlier target is replaced."""
    new = target.with_name(f"{target.name}.new")
    shutil.rmtree(new, ignore_errors=True)
    shutil.copytree(source, new, symlinks=True, ignore=_LEFT_OUT)
    shutil.rmtree(target, ignore_errors=True)
    # The copy is on disk before it gets its name.
    os.sync()
    new.rename(target)
    descriptor = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
