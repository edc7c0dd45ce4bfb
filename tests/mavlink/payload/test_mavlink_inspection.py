"""The example of the driver's page, as a mission of a simulated vehicle in real time."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[3] / "drivers" / "lfield_mavlink" / "README.md"


@pytest.mark.process
@pytest.mark.few(0)
def test_the_program_of_the_page_films_and_takes_a_picture(tmp_path):
    page = PAGE.read_text(encoding="utf-8")
    for name, fence in (("inspection.L", "java"), ("inspection.dL", "text")):
        (block,) = re.findall(rf"```{fence} {name}\n(.*?)```", page, re.DOTALL)
        (tmp_path / name).write_text(block, encoding="utf-8")
    command = [sys.executable, "-m", "lfield", "up", "--deploy", "inspection.dL"]
    command += ["--all", "--sim", "--until-done"]
    ended = subprocess.run(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout
    found = re.search(r"pitch (-?[0-9.]+)", ended.stdout)
    assert found is not None, ended.stdout
    (pitch,) = found.groups()
    # On the ground, at a place on the ground.
    assert abs(float(pitch)) < 0.1
