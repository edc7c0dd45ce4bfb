"""The files of a new mission, for `lfield new`: templates that end in `.in`."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from lfield.driver.plugins import discover
from lfield.driver.skeleton import write_templates
from lfield.lang.checker.symbols import BUILTIN_TYPES

#: Path of each template's file in the directory of the mission.
PLACES = {
    "mission.L": "mission.L",
    "mission.dL": "mission.dL",
    "mission.devices.yaml": "mission.devices.yaml",
    "test.py": "test_$module.py",
}
#: The resources that the program includes.
_INCLUDED = ("Copter", "Rover")


def coordinator_name(name: str) -> str:
    """The coordinator of a mission: `box-search` has BoxSearch."""
    return "".join(part.capitalize() for part in name.split("-"))


def reserved_names() -> set[str]:
    """The types that the program of a new mission has already, besides its coordinator."""
    return {*_INCLUDED, *BUILTIN_TYPES, *discover().device_types}


def write_mission(name: str, folder: Path) -> list[Path]:
    """Write the files of a mission into a directory; returns them. Raises OutputFileError."""
    names = {"Name": coordinator_name(name), "module": name.replace("-", "_")}
    places = {files(__package__) / f"{template}.in": place for template, place in PLACES.items()}
    return write_templates(places, folder, names)
