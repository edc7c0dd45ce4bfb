"""Makes the drivers of the examples available to their tests, as `pip install -e` does."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import pytest

PROJECTS = sorted(Path(__file__).parent.rglob("pyproject.toml"))


def project_folders(site):
    """Writes the metadata of the projects into `site`; returns the folders for the path of Python."""
    for file in PROJECTS:
        project = tomllib.loads(file.read_text())["project"]
        name, version = project["name"], project["version"]
        info = site / f"{name.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        groups = project.get("entry-points", {})
        lines = [
            line
            for group, points in groups.items()
            for line in (f"[{group}]", *(f"{key} = {value}" for key, value in points.items()))
        ]
        (info / "entry_points.txt").write_text("\n".join(lines))
    return [str(site), *(str(file.parent) for file in PROJECTS)]


@pytest.fixture(scope="session")
def projects(tmp_path_factory):
    """The folders of all projects."""
    return project_folders(tmp_path_factory.mktemp("site"))


@pytest.fixture(autouse=True)
def projects_on_path(projects, monkeypatch):
    """Adds the projects to the path of Python, for a test and for its processes."""
    for folder in projects:
        monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*projects, os.environ.get("PYTHONPATH", "")]))
