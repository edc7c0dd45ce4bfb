"""The files of a new driver, for `lfield driver new`: templates that end in `.in`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template

from lfield.errors import OutputFileError

#: Path of each template's file in the new distribution. Variants replace some templates, see VARIANTS.
PLACES = {
    "pyproject.toml": "pyproject.toml",
    "README.md": "README.md",
    "__init__.py": "lfield_$name/__init__.py",
    "manifest.yaml": "lfield_$name/manifest.yaml",
    "driver.py": "lfield_$name/driver.py",
    "device.py": "lfield_$name/device.py",
    "model.py": "lfield_$name/model.py",
    "fake.py": "lfield_$name/fake.py",
    "kit.py": "lfield_$name/kit.py",
    "memory_wire.py": "tests/memory_wire.py",
    "test.py": "tests/test_$name.py",
}
#: Templates of each variant: the folder of that name contains them.
VARIANTS = {
    "sensor": frozenset({"README.md", "manifest.yaml", "device.py", "model.py", "kit.py", "test.py"}),
    "serial": frozenset({"driver.py", "fake.py", "memory_wire.py"}),
}
#: The names about the link in the templates: for TCP, and for a serial port.
TCP = {
    "vendor": "requires=(),",
    "extra": "",
    "endpoint": "lfield_$name.driver:parse_endpoint",
    "listen": "tcp:127.0.0.1:5599",
    "address": "tcp:127.0.0.1:5599",
}
SERIAL = {
    "vendor": 'extra="serial",\n    requires=("serial",),',
    "extra": "[serial]",
    "endpoint": "lfield.driver.serial:parse_serial_endpoint",
    "listen": "/tmp/lfield-$name",
    "address": "serial:/tmp/lfield-$name:115200",
}


def write(name: str, folder: Path, *, sensor: bool = False, serial: bool = False) -> list[Path]:
    """Write the driver `name` (letters and digits) below a folder; returns the files. Raises
    OutputFileError.
    """
    names = {"name": name, "Type": name.capitalize()}
    link = {key: Template(text).substitute(names) for key, text in (SERIAL if serial else TCP).items()}
    chosen = [variant for variant, is_chosen in (("sensor", sensor), ("serial", serial)) if is_chosen]
    source = "sensor/meter.L" if sensor else "mover.L"
    places = PLACES | {source: f"lfield_$name/L/{source.rpartition('/')[2]}"}
    chosen_places = {_template(template, chosen): place for template, place in places.items()}
    return write_templates(chosen_places, folder, names | link)


def _template(name: str, chosen: Sequence[str]) -> Traversable:
    """The file of a template: that of a chosen variant, if it has one."""
    variant = next((f"{each}/" for each in chosen if name in VARIANTS[each]), "")
    return files(__package__) / f"{variant}{name}.in"


def write_templates(places: Mapping[Traversable, str], folder: Path, names: Mapping[str, str]) -> list[Path]:
    """Write a file for each template, at its place below a folder; returns the files.

    `names` replace `$name` in the texts and places. Raises OutputFileError.
    """
    written = []
    for template, place in places.items():
        text = Template(template.read_text(encoding="utf-8")).substitute(names)
        path = folder / Template(place).substitute(names)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None
        written.append(path)
    return written
