"""Writing the files that commands name."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from lfield.errors import OutputFileError


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically. Raises OutputFileError.

    A device or pipe is written to, never replaced.
    """
    temporary: Path | None = None
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as stream:
            temporary = Path(stream.name)
            stream.write(data)
        temporary.chmod(0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise OutputFileError(str(path), error.strerror or str(error)) from None
