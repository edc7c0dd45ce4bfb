"""The commands and code excerpts of the example's README: they run, and match the files."""

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
#: Commands run by other tests: the mission (minutes in real time), and pip.
ELSEWHERE = ("lfield up --deploy examples/16-three-tiers/mission.dL", "pip install -e ")


def pieces(language):
    """The code blocks of the page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def stripped(text):
    """Its lines without indentation."""
    return [line.strip() for line in text.splitlines() if line.strip()]


@pytest.mark.parametrize(("language", "suffix"), [("python", "*.py"), ("yaml", "*.yaml")])
def test_code_on_the_page_is_in_the_driver(language, suffix):
    sources = ["\n".join(stripped(path.read_text())) for path in HOME.glob(f"lfield_planner/{suffix}")]
    found = pieces(language)
    assert found
    for piece in found:
        assert any("\n".join(stripped(piece)) in source for source in sources), piece


@pytest.mark.process
def test_every_line_of_the_page_runs(tmp_path):
    lines = [line for piece in pieces("sh") for line in piece.splitlines()]
    lines = [line for line in lines if not line.startswith(ELSEWHERE)]
    here = f"{shlex.quote(sys.executable)} "
    script = "\n".join(
        line.replace("python -m", f"{here}-m").replace("lfield ", f"{here}-m lfield ", 1)
        if not line.startswith("lfield sim planner")
        # A free port, and no further command before it is ready.
        else f"{here}-m lfield {line[7:-2].replace(':5598', ':0')} > ready & until test -s ready; do :; done"
        for line in lines
    )
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
