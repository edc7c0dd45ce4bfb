"""Bundles are built in the process of a test, where the separate process is not what is tested."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace

import pytest

from lfield.cli.main import main
from lfield.mission import build_cache


def use(patch: pytest.MonkeyPatch) -> None:
    """Run the command of a build in this process, without `python -P -m lfield`."""

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, main(command[4:]))

    patch.setattr(build_cache, "subprocess", SimpleNamespace(run=run, DEVNULL=subprocess.DEVNULL))
