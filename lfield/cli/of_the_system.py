"""What the system refuses, where no room knows better: what is wrong, what to do, and the status."""

from __future__ import annotations

import errno
import os

from lfield import exits
from lfield.text.files import reason

_TOO_MANY = (errno.EMFILE, errno.ENFILE)


def of_the_system(error: OSError) -> tuple[int, str]:
    """The status of exits.py, and a sentence. Without a file it is what is printed that finds no room."""
    if error.errno in _TOO_MANY:
        return exits.UNAVAILABLE, f"{reason(error)}: let this process have more, with 'ulimit -n 1024'"
    if error.errno == errno.ENOENT and not _has_folder():
        return exits.NO_INPUT, "the folder that this is started in has been deleted: go to another one"
    if error.filename:
        return exits.NO_INPUT, f"cannot use {os.fsdecode(error.filename)}: {reason(error)}"
    return exits.INPUT_OUTPUT, reason(error) if error.strerror else str(error)


def _has_folder() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True
