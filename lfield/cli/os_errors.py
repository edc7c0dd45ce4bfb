"""Turns an OSError that no command has handled into an error with an exit status and a remedy."""

from __future__ import annotations

import errno
import os

from lfield import exit_status
from lfield.errors import SystemRefusal
from lfield.text.input_files import error_reason

_TOO_MANY = (errno.EMFILE, errno.ENFILE)


def system_refusal(error: OSError) -> SystemRefusal:
    """The error of a command; without a file name it is about output that could not be written."""
    if error.errno in _TOO_MANY:
        reason = f"{error_reason(error)}: raise the limit of open files, with 'ulimit -n 1024'"
        return SystemRefusal(exit_status.UNAVAILABLE, reason)
    if error.errno == errno.ENOENT and not _has_working_folder():
        return SystemRefusal(exit_status.NO_INPUT, "the working directory was deleted: go to another one")
    if error.filename:
        reason = f"cannot use {os.fsdecode(error.filename)}: {error_reason(error)}"
        return SystemRefusal(exit_status.NO_INPUT, reason)
    reason = error_reason(error) if error.strerror else str(error)
    return SystemRefusal(exit_status.INPUT_OUTPUT, reason)


def _has_working_folder() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True
