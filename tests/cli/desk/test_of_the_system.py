"""What the system refuses is told with what to do, and with a status that fits."""

from __future__ import annotations

import errno
import os

import pytest

from lfield import exits
from lfield.cli.of_the_system import of_the_system


@pytest.mark.parametrize(
    ("number", "file", "status", "words"),
    [
        (errno.EMFILE, None, exits.UNAVAILABLE, "too many open files: let this process have more"),
        (errno.EACCES, "a/b", exits.NO_INPUT, "cannot use a/b: permission denied"),
        (errno.ENOSPC, None, exits.INPUT_OUTPUT, "no space left on device"),
    ],
)
def test_an_error_of_the_system(number: int, file: str | None, status: int, words: str) -> None:
    told = of_the_system(OSError(number, os.strerror(number), file))
    assert told[0] == status
    assert told[1].startswith(words)


def test_a_folder_that_was_deleted(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(FileNotFoundError) as caught:
        os.getcwd()
    status, told = of_the_system(caught.value)
    assert (status, "has been deleted" in told) == (exits.NO_INPUT, True)
