"""A mission made ready for other computers: nothing in it says where its files lay on the desk.

So the same files make the same bundle, in whatever folder they are.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from lfield.bytecode.program import Debug, Program
from lfield.mission.bindings import with_files
from lfield.mission.mission import Mission

#: Of a file that comes with lfield or a driver so many parts of its path are shown: `lfield_can/L/winch.L`.
SHOWN_PARTS = 3


def portable(mission: Mission, folder: Path, devices: Path) -> Mission:
    """The mission with names of sources as seen from `folder`, where its deployment is.

    Files that options of its devices name are seen from the folder `devices` where they are below it: they
    travel beside the bundle. Others keep their whole path.
    """
    names = {source.name: _name(source.name, folder) for source in mission.program.debug.sources}
    warnings = tuple(_renamed(warning, names) for warning in mission.warnings)
    bindings = with_files(mission.bindings, mission.drivers, lambda file: _below(file, devices) or file)
    return replace(mission, program=_with_names(mission.program, names), warnings=warnings, bindings=bindings)


def companions(mission: Mission) -> list[str]:
    """The files that must be copied with the bundle of a portable mission."""
    found: list[str] = []

    def kept(file: str) -> str:
        if not Path(file).is_absolute():
            found.append(file)
        return file

    with_files(mission.bindings, mission.drivers, kept)
    return sorted(set(found))


def _with_names(program: Program, names: dict[str, str]) -> Program:
    debug = program.debug
    sources = tuple(msgspec.structs.replace(source, name=names[source.name]) for source in debug.sources)
    return Program(program.core, Debug(debug.methods, sources), program.digest)


def _name(file: str, folder: Path) -> str:
    """The name of a source in messages."""
    return _below(file, folder) or "/".join(Path(file).parts[-SHOWN_PARTS:])


def _below(file: str, folder: Path) -> str:
    """A file as seen from a folder that it lies in; '' when it does not."""
    try:
        return Path(file).resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return ""


def _renamed(warning: str, names: dict[str, str]) -> str:
    """A drawn warning begins with the name of its source."""
    name = next((name for name in names if warning.startswith(f"{name}:")), None)
    return warning if name is None else names[name] + warning.removeprefix(name)
