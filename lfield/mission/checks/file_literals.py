"""Files that a program names by a literal: read when it is compiled, and part of it from then on.

A parameter of an instruction that is marked `file: plan` in its manifest takes the name of a mission file,
relative to the file of the call. The driver makes a compact text of it, which replaces the name in the
program: so it is bundled, signed, recorded and replayed as every other constant. Once the bindings are known,
the driver checks the plan against the limits and options of each device that may fly it.

`mapArea("north.kml")` becomes an array of the corners in a map file in the same way, and `surveyStrips` an
array of the strips that cover it. The polygons become debug information of the program: a map shows them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct

from lfield.bytecode.program import SourceText
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.errors import MissionFileError, PluginError, ProgramError
from lfield.geodata.area_file import read_area_file
from lfield.geodata.map_drawings import area_text
from lfield.geodata.mission_files import PlanRequest
from lfield.geodata.shapes import Shape, chosen_shape, shape_findings
from lfield.geodata.survey_strips import strip_numbers, survey_strips
from lfield.lang import tree
from lfield.lang.language_library import AREA, STRIPS
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.text.input_files import MAX_TEXT, error_reason, read_within
from lfield.text.source_text import Diagnostic, Span

_MAP_CALLS = (AREA, STRIPS)


class FileLiteral(Struct, frozen=True):
    """One file that a call names. `unit` is the unit of the call, `field` its own device, '' for another."""

    unit: str
    field: str
    device: str
    name: str
    data: bytes
    span: Span


class EmbeddedFiles(NamedTuple):
    """The plans that a program names, and the polygons of map files as GeoJSON, by path."""

    plans: list[FileLiteral]
    areas: list[SourceText]


def embed_files(program: tree.CheckedProgram, plugins: Plugins) -> EmbeddedFiles:
    """Replaces the names of files by their contents. Raises ProgramError."""
    embedding = _Embedding(plugins)
    waiting = [method for unit in program.units for method in unit.methods]
    done = set(map(id, waiting))
    while waiting:
        method = waiting.pop(0)
        for node in _expressions(method):
            embedding.embed(method.unit, node)
            # Functions of the top level are in no unit of the program.
            if isinstance(node, tree.Call) and id(node.method) not in done:
                done.add(id(node.method))
                waiting.append(node.method)
    if embedding.mistakes:
        raise ProgramError(embedding.mistakes)
    areas = [SourceText(path, area_text(list(shapes.values()))) for path, shapes in embedding.areas.items()]
    return EmbeddedFiles(embedding.plans, areas)


def _expressions(method: tree.Method) -> Iterator[tree.Expr]:
    """All expressions of a method."""
    for statement in all_statements(method.body):
        for expression in statement_expressions(statement):
            yield from list(descendants(expression))


class _Embedding:
    """Reads the files of one program."""

    def __init__(self, plugins: Plugins) -> None:
        self.plans: list[FileLiteral] = []
        #: The polygons by path and number in the file.
        self.areas: dict[str, dict[int, Shape]] = {}
        self.mistakes: list[Diagnostic] = []
        self._plugins = plugins

    def embed(self, unit: tree.Unit, node: tree.Expr) -> None:
        """Replaces the files of a call, if it names some."""
        match node:
            case tree.DeviceCall():
                for index, parameter in enumerate(node.instruction.parameters):
                    if parameter.file:
                        self._embed_plan(unit, node, index)
            case tree.Elements(elements=[tree.LibraryCall(operation=operation) as call]) if (
                operation in _MAP_CALLS
            ):
                self._embed_area(node, call)

    def _embed_plan(self, unit: tree.Unit, call: tree.DeviceCall, index: int) -> None:
        argument = call.arguments[index]
        if (name := self._known(argument, call.instruction.name)) is None:
            return
        kind = call.manifest.type
        field = call.device.name if isinstance(call.device, tree.Field) else ""
        with self._reported(name, argument.span):
            data = _read(argument.span, name)
            installed = self._plugins.for_type(kind)
            if installed is None:
                raise PluginError(f"the driver of {kind} is not installed")
            text = installed.plugin.plan_text(name, data)
            self.plans.append(FileLiteral(unit.name, field, kind, name, data, argument.span))
            call.arguments[index] = tree.Literal_(argument.span, argument.type, text)

    def _embed_area(self, array: tree.Elements, call: tree.LibraryCall) -> None:
        is_survey, arguments = call.operation == STRIPS, call.arguments
        function, count = ("surveyStrips", len(arguments) - 2) if is_survey else ("mapArea", len(arguments))
        names = [self._known(argument, function) for argument in arguments[:count]]
        numbers = [self._number(argument) for argument in arguments[count:]]
        file, span = names[0], arguments[0].span
        if file is None or None in names or None in numbers:
            return
        with self._reported(file, span):
            shape = chosen_shape(file, read_area_file(file, _read(span, file)), (*names, "")[1] or "")
            if shape.kind != "polygon":
                raise MissionFileError(file, f"{shape.label} is no area")
            self.areas.setdefault(str(_path(span, file)), {})[shape.number] = shape
            errors = [finding for finding in shape_findings(shape) if finding.is_error]
            self.mistakes += [Diagnostic(each.code, f"{file}: {each.text}", span) for each in errors]
            values = [value for corner in shape.corners for value in corner]
            if is_survey and not errors:
                values = self._strips(
                    shape, [each for each in numbers if each is not None], arguments[-2].span
                )
            array.elements[:] = [tree.Literal_(array.span, call.type, value) for value in values]

    def _strips(self, shape: Shape, numbers: Sequence[float], span: Span) -> list[float]:
        """The strips of an area; none (reported) for an invalid spacing or heading."""
        try:
            return strip_numbers(survey_strips(shape.corners, *numbers))
        except ValueError as error:
            self.mistakes.append(Diagnostic("M303", f"no strips for {shape.label}: {error}", span))
            return []

    def _known(self, argument: tree.Expr, function: str) -> str | None:
        """The text of an argument; None (reported) if the compiler does not know it."""
        if isinstance(argument, tree.Literal_) and isinstance(argument.value, str):
            return argument.value
        self._unknown(argument, f"{function} needs the name of a file")
        return None

    def _number(self, argument: tree.Expr) -> float | None:
        """The number of an argument; None (reported) if the compiler does not know it."""
        inner = argument.operand if isinstance(argument, tree.ToReal) else argument
        if isinstance(inner, tree.Literal_) and isinstance(inner.value, int | float):
            return float(inner.value)
        self._unknown(argument, "surveyStrips needs spacing and heading")
        return None

    def _unknown(self, argument: tree.Expr, expected: str) -> None:
        hint = "the file becomes part of the program when it is compiled"
        self.mistakes.append(Diagnostic("M301", f"{expected} as a literal or constant", argument.span, hint))

    @contextmanager
    def _reported(self, name: str, span: Span) -> Iterator[None]:
        """Reports the reason why a file cannot be read."""
        try:
            yield
        except (OSError, ValueError) as error:
            reason = f"cannot read '{name[:200]}': {error_reason(error)}"
            self.mistakes.append(Diagnostic("M302", reason, span))
        except (MissionFileError, PluginError) as error:
            self.mistakes.append(Diagnostic("M302", str(error), span))


def _read(span: Span, name: str) -> bytes:
    """A file relative to the file of a call. Raises OSError, ValueError."""
    return read_within(_path(span, name), MAX_TEXT)


def _path(span: Span, name: str) -> Path:
    return Path(span.source.name).parent / name


def check_files(
    literals: Sequence[FileLiteral],
    bindings: Iterable[DeviceBinding],
    resources: Mapping[str, str],
    plugins: Plugins,
) -> list[Diagnostic]:
    """Checks each file against the bindings of its device; returns warnings, raises ProgramError.

    `resources` are the resource types of the agents. Calls of a device that was passed to an object are
    checked by the driver only when they are executed.
    """
    findings = [
        finding
        for binding in bindings
        for literal in literals
        if (resources.get(binding.agent), binding.field) == (literal.unit, literal.field)
        for finding in _findings(literal, binding, plugins)
    ]
    if any(finding.severity == "error" for finding in findings):
        raise ProgramError(findings)
    return findings


def _findings(literal: FileLiteral, binding: DeviceBinding, plugins: Plugins) -> Iterator[Diagnostic]:
    installed = plugins.for_type(literal.device)
    if installed is None:
        return
    request = PlanRequest(limits=binding.limits, options=binding.options)
    for finding in installed.plugin.read_plan(literal.name, literal.data, request).findings:
        text = f"{literal.name} for {binding.name}: {finding.text}"
        yield Diagnostic(finding.code, text, literal.span, "", finding.severity)
