"""Files that a program names by a literal: read when it is compiled, and part of it from then on.

A parameter of an instruction that is marked `file: plan` in its manifest takes the name of a mission file,
relative to the file of the call. The driver makes a compact text of it, which replaces the name in the
program: so it is bundled, signed, recorded and replayed as every other constant. Once the bindings are known,
the driver checks the plan against the limits and options of each device that may fly it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.errors import MissionFileError, PluginError, ProgramError
from lfield.geodata.mission_files import PlanRequest
from lfield.lang import tree
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.text.input_files import MAX_TEXT, error_reason, read_within
from lfield.text.source_text import Diagnostic, Span


@dataclass(frozen=True, slots=True)
class FileLiteral:
    """One file that a call names. `unit` is the unit of the call, `field` its own device, '' for another."""

    unit: str
    field: str
    device: str
    name: str
    data: bytes
    span: Span


def embed_files(program: tree.CheckedProgram, plugins: Plugins) -> list[FileLiteral]:
    """Replaces the names of files by their texts. Raises ProgramError with all mistakes."""
    found: list[FileLiteral] = []
    mistakes: list[Diagnostic] = []
    for unit, call, number in _file_arguments(program):
        argument = call.arguments[number]
        if not isinstance(argument, tree.Literal_) or not isinstance(argument.value, str):
            what = f"{call.instruction.name} needs the name of a file as a literal or constant"
            hint = "the file becomes part of the program when it is compiled"
            mistakes.append(Diagnostic("M301", what, argument.span, hint))
            continue
        try:
            literal, text = _read(unit, call, argument.value, argument.span, plugins)
        except (OSError, ValueError) as error:
            reason = f"cannot read '{argument.value[:200]}': {error_reason(error)}"
            mistakes.append(Diagnostic("M302", reason, argument.span))
        except (MissionFileError, PluginError) as error:
            mistakes.append(Diagnostic("M302", str(error), argument.span))
        else:
            found.append(literal)
            call.arguments[number] = tree.Literal_(argument.span, argument.type, text)
    if mistakes:
        raise ProgramError(mistakes)
    return found


def _file_arguments(program: tree.CheckedProgram) -> Iterator[tuple[tree.Unit, tree.DeviceCall, int]]:
    """The arguments for parameters that are files."""
    for unit in program.units:
        for method in unit.methods:
            for statement in all_statements(method.body):
                for expression in statement_expressions(statement):
                    for node in descendants(expression):
                        if isinstance(node, tree.DeviceCall):
                            parameters = enumerate(node.instruction.parameters)
                            yield from ((unit, node, index) for index, each in parameters if each.file)


def _read(
    unit: tree.Unit, call: tree.DeviceCall, name: str, span: Span, plugins: Plugins
) -> tuple[FileLiteral, str]:
    """Raises OSError, ValueError, MissionFileError, PluginError."""
    data = read_within(Path(span.source.name).parent / name, MAX_TEXT)
    kind = call.manifest.type
    installed = plugins.for_type(kind)
    if installed is None:
        raise PluginError(f"the driver of {kind} is not installed")
    text = installed.plugin.plan_text(name, data)
    field = call.device.name if isinstance(call.device, tree.Field) else ""
    return FileLiteral(unit.name, field, kind, name, data, span), text


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
