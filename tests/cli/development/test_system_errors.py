"""Errors of the operating system are reported with a remedy and a suitable status."""

from __future__ import annotations

import errno
import os

import pytest

from lfield import exit_status
from lfield.cli.os_errors import system_refusal


@pytest.mark.parametrize(
    ("number", "file", "status", "words"),
    [
        (errno.EMFILE, None, exit_status.UNAVAILABLE, "too many open files"),
        (errno.EACCES, "a/b", exit_status.NO_INPUT, "cannot use a/b: permission denied"),
        (errno.ENOSPC, None, exit_status.INPUT_OUTPUT, "no space left on device"),
    ],
)
def test_an_error_of_the_operating_system_has_its_status(
    number: int, file: str | None, status: int, words: str
) -> None:
    error = system_refusal(OSError(number, os.strerror(number), file))
    assert (error.exit_status, error.code) == (status, "operating-system")
    assert str(error).startswith(words)


def test_a_deleted_working_folder_is_reported(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    missing = tmp_path / "gone"
    missing.mkdir()
    monkeypatch.chdir(missing)
    missing.rmdir()
    with pytest.raises(FileNotFoundError) as raised:
        os.getcwd()
    error = system_refusal(raised.value)
    assert (error.exit_status, error.code) == (exit_status.NO_INPUT, "operating-system")
    assert "deleted" in str(error)
