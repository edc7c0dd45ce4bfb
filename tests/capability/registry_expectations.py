"""Golden files: the expectation is on the line itself, as `# error C110: part of the message`."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from lfield.capability.model import Registry
from lfield.capability.program_types.live_units import convert_live_units
from lfield.capability.program_types.program_check import (
    check_against,
    check_classes,
    check_feed_portals,
    check_types,
)
from lfield.capability.registry_reader.registry_files import check_files
from lfield.capability.registry_reader.unit_signatures import signatures_of
from lfield.errors import ProgramError
from lfield.lang.parser import parse_file
from lfield.manifest import DeviceManifest, Quantity
from lfield.mission.loader import compile_file
from lfield.text.source_text import Diagnostic, Diagnostics, Source

GOLDEN = Path(__file__).parent / "reading" / "golden"
BASE = GOLDEN / "base.yaml"

_EXPECTED = re.compile(r"# (?P<severity>error|warning) (?P<code>[CY]\d{3}): (?P<part>.*)$")

#: The agents of the deployment with which golden files are read.
AGENTS = ("arm1", "crane1")

#: A device type of a driver.
ROVER = DeviceManifest(
    type="Rover",
    driver="rover",
    instructions=(),
    telemetry=(
        Quantity("battery", "real", "%"),
        Quantity("heat", "real", "°C"),
        Quantity("position", "real[]", "m"),
        Quantity("serial", "string"),
    ),
)


def files_of(case: Path) -> list[Path]:
    """The files of a case: the file itself, or the contents of its folder."""
    return sorted(case.glob("*.yaml")) if case.is_dir() else [case]


def findings(case: Path) -> list[Diagnostic]:
    """All findings of a case together with the base, by all checks."""
    files = files_of(case)
    mission = next((path for path in files if path.name.endswith(".capabilities.yaml")), None)
    registry, found = check_files(
        [BASE, *(path for path in files if path != mission)], mission=mission, agents=AGENTS
    )
    program = case / "program.L"
    return found + (_against(registry, program, mission) if registry is not None else [])


def _against(registry: Registry, program: Path, mission: Path | None) -> list[Diagnostic]:
    found = Diagnostics()
    check_classes(registry, found)
    if program.exists():
        signatures = signatures_of([parse_file(Source(program.name, program.read_text()), found)])
        check_against(registry, signatures, found)
        devices = {name: signature.devices for name, signature in signatures.items()}
        convert_live_units(registry, devices, {"Rover": ROVER}, found)
        with suppress(ProgramError):
            check_feed_portals(registry, compile_file(program)[0], found)
        if mission is not None:
            library = {"hall/lorry.L": program.with_name("lorry.L")}
            check_types(registry, mission, signatures, library.get, found)
    return found.in_order()


def expected(case: Path) -> list[tuple[str, int, str, str, str]]:
    """File, line, severity, code and part of the message, for every expectation of a case."""
    expected_rows = []
    for path in files_of(case):
        for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1):
            match = _EXPECTED.search(line)
            if match:
                expected_rows.append(
                    (str(path), number, match["severity"], match["code"], match["part"].strip())
                )
    return expected_rows


def assert_exactly(case: Path) -> None:
    """The findings are exactly those that the case expects."""
    found = sorted(findings(case), key=lambda d: (d.span.source.name, d.span.line))
    expected_rows = expected(case)
    drawn = "\n".join(d.render() for d in found)
    assert [(d.span.source.name, d.span.line, d.severity, d.code) for d in found] == [
        w[:4] for w in expected_rows
    ], drawn
    for diagnostic, (*_, part) in zip(found, expected_rows, strict=True):
        assert part in diagnostic.message, diagnostic.render()
