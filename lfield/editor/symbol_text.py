"""Signatures and documentation of symbols, as Markdown, for a hover."""

from __future__ import annotations

import json
import re

from lfield.editor.program_parts import PartSource
from lfield.editor.symbols_in_text import TextSymbol
from lfield.lang import tree
from lfield.lang.language_library import LibraryFunction
from lfield.lang.types import VOID
from lfield.manifest import DeviceManifest, Instruction, Parameter
from lfield.text.source_text import Span

_EFFECTS = {"query": "only reads", "idempotent": "may be repeated", "actuate": "acts"}


def hover_text(symbol: TextSymbol, program_text: str | None = None) -> str:
    """The signature of a symbol as L, and its documentation. `program_text` is that of its file."""
    parts = [f"```l\n{signature(symbol)}\n```"]
    match symbol.meaning:
        case DeviceManifest() as device:
            parts.append(_device_text(device))
        case Instruction() as instruction:
            parts.append(_instruction_text(instruction))
        case tuple() as functions:
            parts.extend(function.meaning for function in functions[:1] if function.meaning)
    if symbol.span is not None and symbol.kind != "local":
        parts.append(comment_above(symbol.span, program_text))
    return "\n\n".join(part for part in parts if part)


def signature(symbol: TextSymbol) -> str:
    """The declaration of a symbol on one line or several overloads."""
    match symbol.meaning:
        case tree.Unit() as unit:
            return _unit_signature(unit, symbol.prefix)
        case tree.Method() as method:
            return _method_signature(method)
        case tree.Field() as field:
            return f"{field.type} {field.name}"
        case tree.Local() as local:
            return f"{local.type} {local.name}"
        case tree.Constant() as constant:
            return f"const {constant.type} {constant.name} = {_constant_text(constant)}"
        case tree.Enumeration() as enum if symbol.kind == "member":
            return f"{enum.name}.{symbol.name}  // {enum.members.index(symbol.name)}"
        case tree.Enumeration() as enum:
            return f"enum {enum.name} {{ {', '.join(enum.members)} }}"
        case Instruction() as instruction:
            return _instruction_signature(instruction, symbol.owner)
        case DeviceManifest() as device:
            return f"device {device.type}"
        case tuple() as functions:
            return "\n".join(map(_library_signature, functions))
    return f"class {symbol.name}"


def _unit_signature(unit: tree.Unit, prefix: str) -> str:
    if prefix:
        return {
            "find": f"{unit.name}[] find{unit.name}(string constraint)"
            if unit.capability
            else f"{unit.name} find{unit.name}(string id)\n{unit.name}[] find{unit.name}()",
            "teams": f"{unit.name}[][] teams{unit.name}(string constraint, int size)",
            "explain": f"string explain{unit.name}(string constraint)",
        }[prefix]
    usage = f" {unit.usage} specific" if unit.kind == "class" and unit.usage != "global" else ""
    return f"{unit.kind} {unit.name}{usage}"


def _constant_text(constant: tree.Constant) -> str:
    """The value of a constant as L; of an enum's member its number."""
    value = constant.value
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


def _method_signature(method: tree.Method) -> str:
    parameters = ", ".join(f"{parameter.type} {parameter.name}" for parameter in method.parameters)
    if method.unit.function:
        return f"{method.result} {method.name}({parameters})"
    guarded = "synchronized " if method.synchronized else ""
    if method.kind == "portal":
        emit = "" if method.result == VOID else f" emit {method.result}"
        return f"portal {guarded}{method.unit.name}.{method.name}({parameters}){emit}"
    if method.kind == "loop":
        return f"loop {method.unit.name}.{method.name}"
    if method.kind in ("init", "constructor"):
        return f"{method.name}({parameters})"
    access = "public" if method.public else "private"
    return f"{access} {guarded}{method.result} {method.unit.name}.{method.name}({parameters})"


def _library_signature(function: LibraryFunction) -> str:
    parameters = ", ".join(str(parameter) for parameter in function.parameters)
    return f"{function.result} {function.name}({parameters})"


def _instruction_signature(instruction: Instruction, device: str) -> str:
    parameters = ", ".join(f"{parameter.type} {parameter.name}" for parameter in instruction.parameters)
    return f"{instruction.result} {device}.{instruction.name}({parameters})"


def _instruction_text(instruction: Instruction) -> str:
    lines = [instruction.meaning] if instruction.meaning else []
    lines += [f"- `{parameter.name}`{_unit_and_meaning(parameter)}" for parameter in instruction.parameters]
    if instruction.unit:
        lines.append(f"- returns {instruction.unit}")
    waits = "; waits until it is done" if instruction.blocking else ""
    lines.append(f"- {_EFFECTS[instruction.effect]}{waits}")
    return "\n".join(lines)


def _unit_and_meaning(parameter: Parameter) -> str:
    unit = f" ({parameter.unit})" if parameter.unit else ""
    return f"{unit}: {parameter.meaning}" if parameter.meaning else unit


def _device_text(device: DeviceManifest) -> str:
    names = ", ".join(f"`{instruction.name}`" for instruction in device.instructions)
    states = f"\n\nSafe states: {', '.join(device.safe_states)}" if device.safe_states else ""
    return f"{device.meaning} (driver `{device.driver}`)\n\nInstructions: {names}{states}"


def comment_above(span: Span, program_text: str | None = None) -> str:
    """The comment in the lines above a declaration, or after it in its line, as text."""
    text, start = span.source.text, span.start
    if program_text is not None and isinstance(span.source, PartSource):
        text, start = program_text, start + span.source.place.offset
    before = text[:start].split("\n")
    behind = re.search(r"//(.*)", text[start:].partition("\n")[0])
    lines: list[str] = []
    for line in reversed(before[:-1]):
        if not line.strip().startswith("//"):
            break
        lines.insert(0, line.strip()[2:].removeprefix(" "))
    if lines:
        return "\n".join(lines)
    return behind[1].strip() if behind else ""
