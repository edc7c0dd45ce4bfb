"""The planner's driver is found as if `pip install -e examples/16-three-tiers/planner` had been said."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import pytest

PLANNER = Path(__file__).parent / "planner"


@pytest.fixture(autouse=True)
def plugin_site(tmp_path_factory, monkeypatch):
    """Its entry points, as pip writes them down."""
    project = tomllib.loads((PLANNER / "pyproject.toml").read_text())["project"]
    site = tmp_path_factory.mktemp("site")
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    points = [
        line
        for group, names in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {where}" for name, where in names.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(points) + "\n")
    for path in (str(PLANNER), str(site)):
        monkeypatch.syspath_prepend(path)
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(site), str(PLANNER), os.environ.get("PYTHONPATH", "")])
    )
