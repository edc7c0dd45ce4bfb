"""Interfaces for users and scripts besides printed lines: options, ids of the page, compiled programs."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from command_lines import ROOT
from golden_files import digest

from lfield import exit_status
from lfield.bytecode.disassembler import disassemble
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.cli.main import COMMANDS, MODULES
from lfield.testing.golden import compile_text

PROGRAMS = sorted((ROOT / "tests" / "golden" / "programs").glob("*.L"))


def options_of(parser: argparse.ArgumentParser, command: str) -> Iterator[str]:
    """A line for each option and subcommand, independent of the help format of a Python version."""
    yield f"{command}\n"
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from options_of(below, f"{command} {name}")
        elif not isinstance(action, argparse._HelpAction):
            yield f"  {option(action)}\n"


def option(action: argparse.Action) -> str:
    """Names, values and default of an option."""
    names = " ".join(action.option_strings) or action.dest
    known = (
        ("takes", action.metavar or ""),
        ("count", action.nargs if action.nargs is not None else ""),
        ("choices", " ".join(map(str, action.choices)) if action.choices else ""),
        ("default", "" if action.default in (None, False, argparse.SUPPRESS) else action.default),
        ("required", "yes" if action.required and action.option_strings else ""),
    )
    return "  ".join([names, *(f"{name}: {value}" for name, value in known if value != "")])


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_has_the_options_it_had(golden, command: str) -> None:
    parser = argparse.ArgumentParser()
    import_module(MODULES[command]).add_arguments(parser)
    golden("options").check(command, "".join(options_of(parser, f"lfield {command}")))


def test_an_exit_status_means_what_it_did(golden) -> None:
    meanings = "".join(f"{status:>4}  {text}\n" for status, text in exit_status.MEANINGS.items())
    golden("options").check("exit statuses", meanings)
    golden("options").has_only([*COMMANDS, "exit statuses"])


def test_what_tests_of_the_page_look_for_has_the_ids_it_had(golden) -> None:
    """`data-testid` attributes of the page of `lfield watch`; an id with '-' at the end precedes a name."""
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "lfield").rglob("*.js")]
    found = {name for text in texts for name in re.findall(r"data-testid=\"'?([\w-]+)", text)}
    golden("page").check("data-testid", "".join(f"{name}\n" for name in sorted(found)))


@pytest.mark.few(6)
@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_a_golden_program_is_compiled_to_what_it_was(golden, path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    registry = [path.with_name(name) for name in re.findall(r"// registry: (\S+)", text)]
    program = compile_text(text, path.name, read_registry(registry) if registry else None)
    listing = disassemble(program)
    lines = (
        f"program {program.digest.hex()[:16]}\n{listing.count(chr(10))} lines, SHA-256 {digest(listing)}\n"
    )
    golden("programs").check(path.stem, lines)


def test_all_golden_programs_are_listed(golden) -> None:
    golden("programs").has_only([path.stem for path in PROGRAMS])
