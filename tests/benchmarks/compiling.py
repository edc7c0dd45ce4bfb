"""What a registry of capabilities costs when a program is compiled: examples/03 with 100 capability types."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from harness import ROOT, Figure, Row, in_turns, median, milliseconds, percentile, timed, times

from lfield.capability.reading.reader import read_registry
from lfield.capability.types.language import RegistryTypes
from lfield.compiler.build import compile_program
from lfield.driver.plugins import Plugins
from lfield.lang.frontend import check_text

ROUNDS = 30
#: Capability types in the registry.
TYPES = 100
#: What a program that uses none of them may take against no registry.
TARGET = 1.10

_EXAMPLE = ROOT / "examples" / "03-mixed-team" / "mission.L"
_BASE = "no registry"

_REGISTRY = """\
registry: 1
taxonomy:
  skill: {meaning: behaviours}
"""
_PRIMITIVE = """\
  Act%d:
    id: skill.act%d
    portals:
      go: {parameters: {height: {type: real, unit: m, meaning: how high}}, emit: real, unit: m}
      stop: {meaning: ends it}
"""


def figure() -> Figure:
    """The program without a registry, beside one it does not use, and with more and more of its types."""
    plugins = Plugins()
    for driver in ("mavlink", "can", "dynamixel"):
        plugins.add(f"lfield_{driver}:PLUGIN")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "registry.yaml")
        path.write_text(_registry(), encoding="utf-8")
        samples = in_turns(_cases(plugins, path), ROUNDS)
    base = median(samples[_BASE])
    rows = tuple(_row(name, found, base) for name, found in samples.items())
    note = f"{ROUNDS} rounds; {_EXAMPLE.parent.name} with its stock resources, from text to verified program"
    return Figure("Compiling with a registry of capabilities; ratio to no registry", rows, (note,))


def _cases(plugins: Plugins, registry: Path) -> dict[str, Callable[[], list[float]]]:
    """By name; the registry is read in every round, except where it is said to be read before."""

    def types() -> RegistryTypes:
        return RegistryTypes(lambda: read_registry([registry]))

    def compiled(used: int, kind: Callable[[], RegistryTypes | None]) -> list[float]:
        capabilities = kind()
        return [timed(partial(_compile, plugins, _program(used), capabilities))]

    ready = types()
    cases = {
        _BASE: partial(compiled, 0, lambda: None),
        f"{TYPES} types, none used": partial(compiled, 0, types),
    }
    for used in (1, 10, TYPES):
        cases[f"{used} used, registry read before"] = partial(compiled, used, lambda: ready)
        cases[f"{used} used"] = partial(compiled, used, types)
    return cases


def _compile(plugins: Plugins, text: str, capabilities: RegistryTypes | None) -> None:
    checked = check_text(
        text,
        str(_EXAMPLE),
        devices=plugins.device_types,
        find_include=plugins.find_source,
        capabilities=capabilities,
    )
    compile_program(checked.or_raise())


def _program(used: int) -> str:
    """The example, with a coordinator that asks for so many capabilities."""
    asked = "".join(
        f'        Act{n}[] who{n} = findAct{n}("agent != host"); who{n}[0].go(1.0);\n' for n in range(used)
    )
    asker = f"coordinator Asker {{\n    init(string[] arg) {{\n{asked}    }}\n}}\n" if used else ""
    return _EXAMPLE.read_text(encoding="utf-8") + asker


def _registry() -> str:
    """So many capability types, all served by the copter."""
    numbers = range(TYPES)
    terms = "".join(f"  skill.act{n}: {{meaning: does number {n}}}\n" for n in numbers)
    primitives = "".join(_PRIMITIVE % (n, n) for n in numbers)
    serves = "".join(f"      Act{n}: {{portals: {{go: climb, stop: land}}}}\n" for n in numbers)
    return f"{_REGISTRY}{terms}primitives:\n{primitives}providers:\n  Copter:\n    serves:\n{serves}"


def _row(name: str, samples: list[float], base: float) -> Row:
    own = median(samples)
    target = f"{TARGET:.2f}x" if name.endswith("none used") else ""
    return Row(
        "compile", name, milliseconds(own), milliseconds(percentile(samples, 99)), times(own / base), target
    )
