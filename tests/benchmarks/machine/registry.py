"""What a registry of capabilities costs when a program is compiled: examples/03 with 100 capability types."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Contender, Figure, Opener, timed
from harness.processes import Processes

from lfield.capability.language import RegistryTypes
from lfield.capability.reading.reader import read_registry
from lfield.compiler.build import compile_program
from lfield.driver.plugins import Plugins
from lfield.lang.frontend import check_text

#: Capability types in the registry.
TYPES = 100

_EXAMPLE = Checkout.own().root / "examples/03-mixed-team/mission.L"

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


def compiling(used: int, read: str = "") -> Opener:
    """The example with so many types in use; the registry is read `each` time, `before`, or not at all."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        plugins = Plugins()
        for driver in ("mavlink", "can", "dynamixel"):
            plugins.add(f"lfield_{driver}:PLUGIN")
        path = processes.folder() / "registry.yaml"
        path.write_text(_registry(), encoding="utf-8")
        ready = _types(path)
        kinds: dict[str, Callable[[], RegistryTypes | None]] = {
            "": lambda: None,
            "each": lambda: _types(path),
            "before": lambda: ready,
        }
        text = _program(used)
        return lambda: {"compile": [timed(partial(_compile, plugins, text, kinds[read]()))]}

    return opener


def _types(path: Path) -> RegistryTypes:
    return RegistryTypes(lambda: read_registry([path]))


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


_CASES = {"no registry": compiling(0), f"{TYPES} types, none used": compiling(0, "each")} | {
    f"{used} used" + (", read before" if read == "before" else ""): compiling(used, read)
    for used in (1, 10, TYPES)
    for read in ("before", "each")
}

FIGURE = Figure(
    "Compiling with a registry of capabilities; ratio to no registry",
    _CASES,
    base=("no registry",),
    rounds=15,
    targets={f"{TYPES} types, none used": "1.10x"},
    notes=(f"{_EXAMPLE.parent.name} with its stock resources, from text to verified program",),
)
