"""Contents of files for the map: those that a program names, and those that the operator names.

A program contains its plans as constants, and its areas as debug information.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from msgspec.structs import replace

from lfield.bytecode.program import Program
from lfield.driver.plugins import discover
from lfield.errors import MissionFileError, PluginError, UsageError
from lfield.geodata.area_file import is_area_file
from lfield.geodata.map_drawings import MapDrawing, area_drawings, drawings_of
from lfield.geodata.mission_files import PlanRequest
from lfield.text.input_files import MAX_TEXT, read_bytes


def program_drawings(program: Program) -> list[MapDrawing]:
    """The plans and areas that a program names, without files that no installed driver reads."""
    debug = program.debug
    with_methods = {method.source for method in debug.methods}
    others = (source for number, source in enumerate(debug.sources) if number not in with_methods)
    plans = (
        each.partition("\n") for each in program.core.constants if isinstance(each, str) and "\n" in each
    )
    files = [(source.name, source.text) for source in others]
    files += [(name, body) for name, _, body in plans] if _accepts_plans(program) else []
    found: list[MapDrawing] = []
    for name, text in files:
        try:
            found += _drawings(name.rpartition("/")[2], text.encode())
        except (MissionFileError, PluginError, UsageError, UnicodeError):
            continue
    return found


def _accepts_plans(program: Program) -> bool:
    """Whether a device of the program has an instruction that takes a plan."""
    types = discover().device_types
    known = [types[name] for name in {call.device for call in program.core.device_calls} if name in types]
    return any(parameter.file for t in known for each in t.instructions for parameter in each.parameters)


def file_drawings(paths: Iterable[Path]) -> list[MapDrawing]:
    """The drawings of plan and area files. Raises MissionFileError, InputFileError, UsageError."""
    found: list[MapDrawing] = []
    for path in paths:
        drawings = _drawings(str(path), read_bytes(path, MAX_TEXT))
        if not drawings:
            raise MissionFileError(str(path), "it has nothing to draw; 'lfield plan check' lists its faults")
        found += [replace(drawing, name=path.name) for drawing in drawings]
    return found


def _drawings(name: str, data: bytes) -> list[MapDrawing]:
    """The drawings of one file. Raises MissionFileError, PluginError, UsageError."""
    if is_area_file(name, data):
        return area_drawings(name, data)
    return drawings_of(name, discover().plan_reader.read_plan(name, data, PlanRequest()))
