"""The checks of blocks, by the words after the fence. Each check returns a sentence for each error."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import textwrap
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import NoReturn

import yaml as parsed
from document_blocks import Block, shell_lines
from msgspec import structs

from lfield.capability.registry_reader.registry_files import check_files
from lfield.cli.main import COMMANDS, MODULES
from lfield.devices.fake_processes import fault_options
from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.driver.manifest_file import load_manifest
from lfield.driver.plugins import discover
from lfield.driver.sims import sims_of
from lfield.errors import BindingError, DevicesError, LfieldError, ProgramError
from lfield.lang.deployment import read_deployment
from lfield.mission.device_selection import devices_in_file
from lfield.mission.loader import ACCESS, compile_file, load_mission
from lfield.testing.desk import Desk
from lfield.testing.driver_bench import GuardedDevice

Problems = list[str]
Check = Callable[[Block, Path], Problems]

_COMMAND = re.compile(r"(?:^|&& )(?:\.venv/bin/)?lfield ((?:[^&|#'\"]|'[^']*'|\"[^\"]*\")+)")
_STATUS = re.compile(r"#.*\bstatus (\d+)")


def sentences(work: Callable[[], object]) -> Problems:
    """The errors that lfield raises in a function: a text for each finding."""
    try:
        work()
    except ProgramError as error:
        return [finding.render() for finding in error.diagnostics]
    except BindingError as error:
        return list(error.problems)
    except LfieldError as error:
        return [str(error)]
    return []


def program(block: Block, folder: Path) -> Problems:
    """L: a whole program, or statements of a method of a resource with the device that they need."""
    text = block.text
    if block.words[:1] == ["statements"]:
        text = _around(block)
    elif block.words and not block.file:
        return [f"there is no rule for '{block.info}'"]
    path = folder / (block.file or f"block{block.line}.L")
    path.write_text(text, encoding="utf-8")
    found: Problems = []

    def compiled() -> None:
        found.extend(warning.render() for warning in compile_file(path)[1])

    problems = sentences(compiled)
    if "wrong" in block.words:
        return [] if problems else ["an error is expected, and none is found"]
    return problems + ([] if block.words[:1] == ["statements"] else found)


def _around(block: Block) -> str:
    """A program with these statements in a resource with their device, or in a coordinator without one."""
    kind, field = (
        ("resource", f"{' '.join(block.words[2:])};") if block.words[1:2] == ["of"] else ("coordinator", "")
    )
    return f"{kind} Page {{ {field} init(string[] arg) {{\n{block.text}}} }}\n"


def plain_text(block: Block, folder: Path) -> Problems:
    """A deployment. The test that runs the commands compares the output of programs."""
    if block.file.endswith(".dL"):
        path = folder / block.file
        program = folder / block.words[2] if block.words[1:2] == ["of"] else path.with_suffix(".L")
        if program.exists():
            return sentences(lambda: load_mission(path, program, simulate=True))
        return sentences(lambda: read_deployment(path, None))
    if block.words not in (["output"], ["drawing"]):
        return [f"there is no rule for '{block.info}': write text FILE.dL, text output or text drawing"]
    return []


#: By driver: an endpoint for the options that a page shows.
ENDPOINTS = {
    "mavlink": "udp:127.0.0.1:14550",
    "can": "socketcan:can0",
    "dynamixel": "serial:/dev/ttyUSB0:57600",
}


def yaml(block: Block, folder: Path) -> Problems:
    """A manifest, a registry or bindings, read by lfield. The check opens bound devices on their fakes."""
    words, text = block.words, block.text
    if words[:1] == ["device"]:
        text = "agents:\n  page:\n    devices:\n" + textwrap.indent(textwrap.dedent(text), " " * 6)
    elif words[:1] == ["options"]:
        driver = f"driver: {words[1]}\nendpoint: {ENDPOINTS[words[1]]}\n"
        text = "agents:\n  page:\n    devices:\n      device:\n" + textwrap.indent(driver + text, " " * 8)
    elif words and not block.file:
        return [f"there is no rule for '{block.info}'"]
    path = folder / (block.file or f"block{block.line}.yaml")
    path.write_text(text, encoding="utf-8")
    if unreadable := _unreadable(text):
        return unreadable
    if text.startswith("driver:"):
        return sentences(lambda: load_manifest(path.name, text.encode()))
    if re.search(r"^registry:", text, re.MULTILINE):
        return [finding.render() for finding in check_files(mission=path)[1]]
    if path.name.endswith(ACCESS):
        return sentences(lambda: load_mission(path.with_name(path.name.replace(ACCESS, ".dL"))))
    devices: list[DeviceBinding] = []
    problems = sentences(lambda: devices.extend(_bound(path)))
    return problems if words[:1] == ["options"] else problems + opened(devices)


def _unreadable(text: str) -> Problems:
    """The error of a text that is not YAML with a mapping or a list."""
    try:
        found = parsed.safe_load(text)
    except parsed.YAMLError as error:
        return [f"no YAML: {' '.join(str(error).split())}"]
    return [] if isinstance(found, dict | list) else ["there is neither a mapping nor a list in it"]


def _bound(path: Path) -> list[DeviceBinding]:
    """The devices of a bindings file on their fakes: of its mission if there is one, else of its drivers."""
    deployment = path.with_name(path.name.removesuffix(".devices.yaml") + ".dL")
    plugins = discover()
    if deployment.exists():
        mission = load_mission(deployment, devices=path, simulate=True)
        written = path.read_text(encoding="utf-8")
        return [
            device
            for device in mission.bindings.all
            if re.search(rf"^  {device.agent}:", written, re.MULTILINE)
        ]
    drivers = sorted(set(re.findall(r"driver: *(\w+)", path.read_text(encoding="utf-8"))))
    found = [d for name in drivers for d in devices_in_file(path, plugins.by_driver[name], plugins, "")]
    return [structs.replace(device, endpoint=f"{SIMULATED}{device.name}") for device in found]


def opened(devices: list[DeviceBinding]) -> Problems:
    """The problems when these devices are opened on fakes in virtual time, such as a slow watchdog."""
    found: Problems = []
    for device in devices:
        desk, sim = Desk(), sims_of({device.driver})[device.driver]
        fake = desk.fake(sim, *sim.arguments([device]), *fault_options([device]))
        try:
            desk.run(_only_opened, structs.replace(device, endpoint=fake.endpoint))
        except DevicesError as error:
            found += error.problems
    return found


async def _only_opened(device: GuardedDevice) -> None:
    assert device


def data(block: Block, folder: Path) -> Problems:
    """JSON."""
    try:
        json.loads(block.text)
    except ValueError as error:
        return [str(error)]
    return []


def python(block: Block, folder: Path) -> Problems:
    """Python that compiles."""
    try:
        compile(block.text, block.place, "exec")
    except SyntaxError as error:
        return [str(error)]
    return []


def grammar(block: Block, folder: Path) -> Problems:
    """Each rule that a grammar rule names exists. Rules in capitals are partly prose, and are not checked."""
    text = re.sub(r"\(\*.*?\*\)|'[^']*'|\"[^\"]+\"", "", block.text)
    text = re.split(r"^[A-Z]+ ", text, maxsplit=1, flags=re.MULTILINE)[0]
    rules = dict(re.findall(r"^(\w+)\s+=((?:.|\n(?!\w))*)", text, re.MULTILINE))
    used = {name for body in rules.values() for name in re.findall(r"\b[a-z]\w+\b", body)}
    return [f"there is no rule '{name}'" for name in sorted(used - rules.keys())]


def diagram(block: Block, folder: Path) -> Problems:
    """A state diagram whose lines are arrows with a label."""
    head, *lines = block.text.splitlines()
    problems = [] if head == "stateDiagram-v2" else [f"there is no rule for a '{head}'"]
    return problems + [
        f"no arrow: {line}"
        for line in lines
        if not re.fullmatch(r"\s+(\w+|\[\*\]) --> (\w+|\[\*\]): .+", line)
    ]


def udev(block: Block, folder: Path) -> Problems:
    """Rules of udev: comma-separated matches and assignments."""
    rule = re.compile(r'[A-Z]+(\{\w+\})?(==|=|\+=)"[^"]*"')
    return [
        f"no rule: {line}"
        for line in block.text.splitlines()
        if not all(map(rule.fullmatch, line.split(", ")))
    ]


def shell(block: Block, folder: Path) -> Problems:
    """The parser of lfield accepts its command lines, also those that no test runs."""
    problems = []
    for line in shell_lines(block.text):
        for words in _COMMAND.findall(line):
            try:
                parse_command(words)
            except ValueError as error:
                problems.append(f"{line}: {error}")
    return problems


class Strict(argparse.ArgumentParser):
    """A parser that raises ValueError instead of SystemExit, and refuses abbreviated options."""

    def __init__(self, **options: object) -> None:
        super().__init__(**{"prog": "lfield", **options, "allow_abbrev": False})  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def parse_command(line: str) -> None:
    """Parse the words after `lfield` with the parser of the command. Raises ValueError."""
    name, *words = shlex.split(line, comments=True)
    if name not in COMMANDS:
        raise ValueError(f"there is no subcommand '{name}'")
    if name in ("sim", "kit") and {"lamp", "gps", "planner", "$name"}.intersection(words):
        # The preceding lines of the page created or installed this driver.
        return
    parser = Strict()
    import_module(MODULES[name]).add_arguments(parser)
    parser.parse_args(words)


def expected_status(line: str) -> int:
    """The expected exit status of a line."""
    found = _STATUS.search(line)
    return int(found[1]) if found else 0


#: By the first word after the fence.
CHECKS: Mapping[str, Check] = {
    "java": program,
    "text": plain_text,
    "yaml": yaml,
    "json": data,
    "python": python,
    "ebnf": grammar,
    "mermaid": diagram,
    "udev": udev,
    "sh": shell,
}


def problems_of(block: Block, folder: Path) -> Problems:
    """All errors of a block, each after the page and line of the block."""
    check = CHECKS.get(block.language)
    if check is None:
        return [f"{block.place}: there is no rule for a block of '{block.info}'"]
    if block.file:
        (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
        (folder / block.file).write_text(block.text, encoding="utf-8")
    return [f"{block.place}: {problem}" for problem in check(block, folder)]


def missing_lines(expected: str, output: str) -> Problems:
    """The lines of a block of output that a command did not print. Figures are ignored."""
    printed = {_plain(line) for line in output.splitlines()}
    lines = [line for line in expected.splitlines() if line.strip() and line.strip() != "..."]
    return [
        f"was not printed: {line}"
        for line in lines
        if not line.startswith("$ ") and _plain(line) not in printed
    ]


def _plain(line: str) -> str:
    return re.sub(r"[0-9]+(\.[0-9]+)?|(?<==)[0-9a-f]{8,}", "#", re.sub(r" +", " ", line.strip()))
