"""Makes a mission independent of the folder that it was built in.

Then the same files produce the same bundle in any folder.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from lfield.bytecode.program import Debug, Program
from lfield.mission.bindings import with_files
from lfield.mission.mission import Mission

#: Number of path components that are shown of a file of lfield or a driver: `lfield_can/L/winch.L`.
SHOWN_PARTS = 3


def relocate(mission: Mission, folder: Path, devices: Path) -> Mission:
    """The mission with source names relative to `folder`, which has its deployment.

    Paths of files in device options are relative to the folder `devices` where they are below it: they are
    copied into the folder of the bundle. Others stay absolute.
    """
    names = {source.name: _name(source.name, folder) for source in mission.program.debug.sources}
    warnings = tuple(_renamed(warning, names) for warning in mission.warnings)
    bindings = with_files(mission.bindings, mission.drivers, lambda file: _below(file, devices) or file)
    return replace(mission, program=_with_names(mission.program, names), warnings=warnings, bindings=bindings)


def companion_files(mission: Mission, host: str = "") -> list[str]:
    """The files that must be copied with the bundle of a relocated mission, for `host` or for all."""
    found: list[str] = []
    own = {device.name for device in mission.devices_of(host)} if host else None

    def collect(file: str) -> str:
        if not Path(file).is_absolute():
            found.append(file)
        return file

    with_files(mission.bindings, mission.drivers, collect, own)
    return sorted(set(found))


def _with_names(program: Program, names: dict[str, str]) -> Program:
    debug = program.debug
    sources = tuple(msgspec.structs.replace(source, name=names[source.name]) for source in debug.sources)
    return Program(program.core, Debug(debug.methods, sources), program.digest)


def _name(file: str, folder: Path) -> str:
    """The name of a source in messages."""
    return _below(file, folder) or "/".join(Path(file).parts[-SHOWN_PARTS:])


def _below(file: str, folder: Path) -> str:
    """A file relative to a folder that contains it; '' for any other folder."""
    try:
        return Path(file).resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return ""


def _renamed(warning: str, names: dict[str, str]) -> str:
    """A rendered warning with the new name of its source, with which it starts."""
    name = next((name for name in names if warning.startswith(f"{name}:")), None)
    return warning if name is None else names[name] + warning.removeprefix(name)
