"""Every fenced block of every document is true: programs compile, files check, lines run and print what is shown."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from document_blocks import ROOT, Block, blocks_by_page, blocks_of, shell_lines
from document_checks import missing_lines, problems_of, understand, wanted_status
from document_exceptions import EXCEPTIONS, FILES

pytestmark = pytest.mark.process

BLOCKS = blocks_by_page()
#: What commands of the documents name, from the root of the repository.
NAMED = ("examples", "deploy", "capabilities")


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    """A copy of what the documents name, to run their lines in."""
    for folder in NAMED:
        shutil.copytree(ROOT / folder, tmp_path / folder)
    return tmp_path


def prepare(page: str, folder: Path) -> None:
    """The files that a page speaks of, and those that it shows."""
    for name, source in FILES.get(page, {}).items():
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / source, folder / name)
    for block in BLOCKS[page]:
        if block.file:
            (folder / block.file).parent.mkdir(exist_ok=True)
            (folder / block.file).write_text(block.text, encoding="utf-8")


def run(line: str, folder: Path) -> tuple[int, str]:
    """Run a command line; its status and all that it prints."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "HOME": str(folder)}
    done = subprocess.run(
        ["bash", "-c", line], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout


def played(page: str, folder: Path) -> list[str]:
    """Run the lines of a page in their order; what was not as it is shown."""
    problems, said = [], ""
    skipped = EXCEPTIONS.get(page, {})
    for block in BLOCKS[page]:
        output = block.info == "text output"
        own = [line for line in block.text.splitlines() if line.startswith("$ ")] if output else []
        if block.language == "sh" or own:
            said = ""
        for line in shell_lines("\n".join(own)) if output else shell_lines(block.text) * (block.language == "sh"):
            if line in skipped:
                continue
            status, printed = run(line, folder)
            said += printed
            if status != wanted_status(line):
                problems.append(f"{block.place}: {line}: status {status}: {printed}")
        if output and block.text.splitlines()[0] not in skipped:
            problems += [f"{block.place}: {each}" for each in missing_lines(block.text, said)]
    return problems


@pytest.mark.parametrize("page", BLOCKS)
def test_every_block_is_what_it_says(page: str, scratch: Path) -> None:
    prepare(page, scratch)
    problems = [problem for block in BLOCKS[page] for problem in problems_of(block, scratch)]
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("page", [page for page, blocks in BLOCKS.items() if any(b.language == "sh" for b in blocks)])
def test_every_line_runs(page: str, scratch: Path) -> None:
    prepare(page, scratch)
    problems = played(page, scratch)
    assert not problems, "\n".join(problems)
