"""Every program of the repository is formatted, and formatting does not change the compiled code."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine_fuzzer.engine_trial import registry_of
from engine_fuzzer.program_generator import random_program
from lfield.editor.layout.formatter import format_deployment, format_program
from lfield.editor.layout.source_items import source_items
from lfield.errors import ProgramError
from lfield.testing.golden import compile_text
from lfield.text.source_text import Source

ROOT = Path(__file__).resolve().parents[2]
#: Programs with syntax errors, and templates: they cannot be formatted.
REFUSED = (
    "tests/lang/golden/errors/",
    "tests/lang/golden/foreign/",
    "tests/benchmarks/team/formation.L",
    "tests/benchmarks/team/recovery.L",
)
GOLDEN = sorted((ROOT / "tests/golden/programs").glob("*.L"))
#: Whitespace and comments between two tokens of a program with a random layout.
GAPS = (
    " ",
    " ",
    "\n",
    "\n\n\n",
    "  \t",
    " \n\t ",
    "\r\n",
    " /* c */ ",
    " // c\n",
    "\n// c\n\n",
    " /* c\nd */ ",
)


def tracked(pattern: str) -> Iterator[tuple[str, Source]]:
    """The tracked files that match a pattern."""
    command = ["git", "ls-files", pattern]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        yield name, Source(name, (ROOT / name).read_bytes().decode("utf-8", "replace"))


def test_every_program_of_the_repository_is_formatted() -> None:
    different = []
    for name, source in tracked("*.L"):
        try:
            formatted = format_program(source)
        except ProgramError:
            assert name.startswith(REFUSED), name
            continue
        if formatted != source.text:
            different.append(name)
    assert different == [], "run 'lfield fmt' on these programs"


def test_every_deployment_of_the_examples_is_formatted() -> None:
    for name, source in tracked("examples/*.dL"):
        assert format_deployment(source) == source.text, name


def with_random_layout(text: str, rng: random.Random) -> str:
    """The same program with a random layout and random comments."""
    pieces = []
    for item in source_items(Source("p.L", text)):
        pieces += [item.text, "\n" if item.ends_line else rng.choice(GAPS)]
    return "".join(pieces)


def check_layouts(text: str, rng: random.Random) -> None:
    """Check the formatting of a program with its own layout and with a random one."""
    registry = registry_of(text)
    compiled = compile_text(text, registry=registry).digest
    for written in (text, with_random_layout(text, rng)):
        formatted = format_program(Source("p.L", written))
        assert format_program(Source("p.L", formatted)) == formatted
        assert compile_text(formatted, registry=registry).digest == compiled


@pytest.mark.few(12)
@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_program_compiles_to_the_same_code_in_any_layout(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if "// registry:" not in text:
        check_layouts(text, random.Random(path.stem))


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(200))
def test_random_program_compiles_to_the_same_code_in_any_layout(seed: int) -> None:
    check_layouts(random_program(random.Random(seed)).text(), random.Random(seed))
