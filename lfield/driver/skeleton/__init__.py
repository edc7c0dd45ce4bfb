"""The files of a new driver, for `lfield driver new`: templates that end in `.in`."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from string import Template

from lfield.errors import OutputFileError

#: Where each template goes, below the folder of the new distribution. A sensor has some of its own.
PLACES = {
    "pyproject.toml": "pyproject.toml",
    "README.md": "README.md",
    "__init__.py": "lfield_$name/__init__.py",
    "manifest.yaml": "lfield_$name/manifest.yaml",
    "driver.py": "lfield_$name/driver.py",
    "device.py": "lfield_$name/device.py",
    "fake.py": "lfield_$name/fake.py",
    "kit.py": "lfield_$name/kit.py",
    "test.py": "tests/test_$name.py",
    "mover.L": "lfield_$name/L/mover.L",
}
SENSOR = {"README.md", "manifest.yaml", "device.py", "fake.py", "kit.py", "test.py", "meter.L"}


def write(name: str, folder: Path, *, sensor: bool = False) -> list[Path]:
    """Write the driver `name` (letters and digits) below a folder; the files. Raises OutputFileError."""
    words = {"name": name, "Type": name.capitalize()}
    places = {template: place for template, place in PLACES.items() if not (sensor and template == "mover.L")}
    if sensor:
        places["meter.L"] = "lfield_$name/L/meter.L"
    written = []
    for template, place in places.items():
        room = "sensor/" if sensor and template in SENSOR else ""
        text = (files(__package__) / f"{room}{template}.in").read_text(encoding="utf-8")
        path = folder / Template(place).substitute(words)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(Template(text).substitute(words), encoding="utf-8")
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None
        written.append(path)
    return written
