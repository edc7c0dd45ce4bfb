"""The mission of the tutorial runs in real time and prints the output on the page: `make test-more`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from document_blocks import ROOT, blocks_of
from document_checks import missing_lines

PAGE = "lfield/docs/getting-started.md"

pytestmark = [pytest.mark.process, pytest.mark.few(0), pytest.mark.timeout(240)]


def test_tutorial_mission_prints_the_output_of_the_page(tmp_path: Path) -> None:
    blocks = list(blocks_of(PAGE, (ROOT / PAGE).read_text(encoding="utf-8")))
    for block in blocks:
        if block.file and not block.file.endswith(".devices.yaml"):
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
    command = "up --deploy mission.dL --all --sim --until-done"
    done = subprocess.run(
        [sys.executable, "-m", "lfield", *command.split()],
        cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    (excerpt,) = (block.text for block in blocks if block.text.startswith("west | boss: row 0 done"))
    assert done.returncode == 0, done.stderr
    assert missing_lines(excerpt, done.stdout + done.stderr) == []
