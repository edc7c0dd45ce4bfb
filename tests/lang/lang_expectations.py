"""Golden files: each expected diagnostic is a comment on its line, `// error L405: part of the message`."""

from __future__ import annotations

import re
from pathlib import Path

from lfield.capability.program_types.registry_types import RegistryTypes
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.manifest import DeviceManifest, Instruction, Parameter
from lfield.text.source_text import Diagnostic

GOLDEN = Path(__file__).parent / "golden"
REGISTRY = GOLDEN.parents[1] / "golden" / "programs" / "lifting.yaml"
THESIS = Path(__file__).parents[2].parent / "shared" / "thesis-programs"

_EXPECTED = re.compile(r"(?P<severity>error|warning) (?P<code>L\d{3}): (?P<part>.*)$")

#: A device type of a driver.
ROVER = DeviceManifest(
    type="Rover",
    driver="rover",
    instructions=(
        Instruction("drive", (Parameter("speed", "real", "m/s"),)),
        Instruction("distance", (), result="real", unit="m", effect="query"),
        Instruction("scan", (Parameter("angles", "real[]", "rad"),), result="int[]", effect="query"),
    ),
)

#: The capabilities Lift, Climb, Grip and FirmGrip.
CAPABILITIES = RegistryTypes(lambda: read_registry([REGISTRY]))


def expected(path: Path) -> list[tuple[int, str, str, str]]:
    """Line, severity, code and part of the message, for every expectation in a file."""
    lines = path.read_bytes().decode("utf-8", "replace").split("\n")
    found = []
    for number, line in enumerate(lines, 1):
        match = _EXPECTED.search(line)
        if match:
            found.append((number, match["severity"], match["code"], match["part"].strip()))
    return found


def assert_exactly(path: Path, diagnostics: list[Diagnostic]) -> None:
    """The diagnostics are exactly those that the file expects."""
    expectations = expected(path)
    rendered = "\n".join(d.render() for d in diagnostics)
    assert [(d.span.line, d.severity, d.code) for d in diagnostics] == [each[:3] for each in expectations], (
        rendered
    )
    for diagnostic, (_, _, _, part) in zip(diagnostics, expectations, strict=True):
        assert part in diagnostic.message, diagnostic.render()
