"""The commands of the example's README run, and its code equals that of the files."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

HOME = Path(__file__).parents[1]
PAGE = (HOME.parent / "README.md").read_text(encoding="utf-8")
#: Commands that are not run here: the mission, which other tests run in virtual time, and pip.
NOT_RUN = ("lfield up --deploy examples/16-three-tiers/mission.dL", "pip install -e ")


def code_blocks(language):
    """The code blocks of the README in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def without_indentation(text):
    """The lines of a text without indentation and empty lines."""
    return [line.strip() for line in text.splitlines() if line.strip()]


@pytest.mark.parametrize(("language", "suffix"), [("python", "*.py"), ("yaml", "*.yaml")])
def test_code_of_the_readme_is_in_the_driver(language, suffix):
    paths = HOME.glob(f"lfield_planner/{suffix}")
    sources = ["\n".join(without_indentation(path.read_text())) for path in paths]
    blocks = code_blocks(language)
    assert blocks
    for block in blocks:
        assert any("\n".join(without_indentation(block)) in source for source in sources), block


def shell_line(line):
    """A command with the Python of this test; the simulated planner gets a free port."""
    python = shlex.quote(sys.executable)
    if line.startswith("lfield sim planner"):
        command = line.removesuffix(" &").replace(":5598", ":0")
        return f"{python} -m {command} > ready & until test -s ready; do :; done"
    return line.replace("python -m", f"{python} -m").replace("lfield ", f"{python} -m lfield ", 1)


@pytest.mark.few(0)
@pytest.mark.process
def test_every_command_of_the_readme_runs(tmp_path):
    lines = [line for block in code_blocks("sh") for line in block.splitlines()]
    lines = [line for line in lines if not line.startswith(NOT_RUN)]
    script = "\n".join(map(shell_line, lines))
    done = subprocess.run(
        ["bash", "-ec", f"trap 'kill %1' EXIT\n{script}"],
        cwd=tmp_path, env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(lines) == 5
    assert (tmp_path / "router" / "lfield_router" / "manifest.yaml").is_file()
    assert '{"tour": [0, 1]}' in done.stdout.splitlines()
    assert "slow = 1e+06" in done.stdout.replace("1000000.0", "1e+06")
    assert "7 passed, 0 failed, 2 not run" in done.stdout
