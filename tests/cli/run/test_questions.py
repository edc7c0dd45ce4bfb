"""Questions on a terminal, and contradicting options of `up`."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from lfield.cli.main import main

ASK = "import sys; from lfield.cli.confirmation import confirm; sys.exit(10 + confirm('really? '))"


@pytest.mark.process
@pytest.mark.parametrize(
    ("typed", "agreed"), [(b"YES \n", True), (b"y\n", False), (b"\n", False), (b"\x04", False)]
)
def test_only_yes_agrees_and_end_of_input_is_no_error(typed: bytes, agreed: bool) -> None:
    keyboard, terminal = os.openpty()
    try:
        os.write(keyboard, typed)
        process = subprocess.run([sys.executable, "-c", ASK], stdin=terminal, capture_output=True, timeout=60)
    finally:
        os.close(keyboard)
        os.close(terminal)
    assert (process.returncode, process.stderr) == (10 + agreed, b"")


def test_a_volatile_host_with_a_state_folder_is_refused(tmp_path, capsys) -> None:
    (tmp_path / "one.L").write_text("resource Post { init(string[] arg) { } }\n")
    (tmp_path / "one.dL").write_text("//Post:post@home\n")
    arguments = ["up", str(tmp_path / "one.dL"), "--host", "home", "--volatile", "--state", str(tmp_path)]
    assert main(arguments) == 64
    assert "--volatile runs without a journal, and --state names" in capsys.readouterr().err
