"""The registry that comes with lfield: `capabilities/`, which in a wheel lies in the package."""

from __future__ import annotations

from pathlib import Path

import lfield
from lfield.text.source import Diagnostic


def shipped_folder() -> Path:
    """Where the files of the registry are; their classes in L are in the folder `L` there."""
    package = Path(lfield.__file__).resolve().parent
    installed = package / "registry"
    return installed if installed.is_dir() else package.parent / "capabilities"


def is_shipped(finding: Diagnostic) -> bool:
    """Whether a finding is about a file that comes with lfield."""
    return Path(finding.span.source.name).parent == shipped_folder()


def shipped() -> list[Path]:
    """The files of the registry that comes with lfield, by name."""
    return sorted(shipped_folder().glob("*.yaml"))
