"""The check of a block by its words: each returns a sentence for every error."""

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
    """The errors that lfield raises in a function, each finding rendered."""
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
    """L: a whole program, or statements in a method of a resource that has their device."""
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
    """Statements as a program: in a resource with the device they name, else in a coordinator."""
    kind, field = (
        ("resource", f"{' '.join(block.words[2:])};") if block.words[1:2] == ["of"] else ("coordinator", "")
    )
    return f"{kind} Page {{ {field} init(string[] arg) {{\n{block.text}}} }}\n"


def plain_text(block: Block, folder: Path) -> Problems:
    """A deployment; the output of programs is compared where they run."""
    if block.file.endswith(".dL"):
        path = folder / block.file
        program = folder / block.words[2] if block.words[1:2] == ["of"] else path.with_suffix(".L")
        if program.exists():
            return sentences(lambda: load_mission(path, program, simulate=True))
        return sentences(lambda: read_deployment(path, None))
    if block.words not in (["output"], ["drawing"]):
        return [f"there is no rule for '{block.info}': write text FILE.dL, text output or text drawing"]
    return []


#: An endpoint of each driver whose options a page shows.
ENDPOINTS = {
    "mavlink": "udp:127.0.0.1:14550",
    "can": "socketcan:can0",
    "dynamixel": "serial:/dev/ttyUSB0:57600",
}


def yaml(block: Block, folder: Path) -> Problems:
    """A manifest, registry or bindings, read as lfield does; bound devices are opened on their fakes."""
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
    """Why a text is not YAML with a mapping or a list."""
    try:
        found = parsed.safe_load(text)
    except parsed.YAMLError as error:
        return [f"no YAML: {' '.join(str(error).split())}"]
    return [] if isinstance(found, dict | list) else ["there is neither a mapping nor a list in it"]


def _bound(path: Path) -> list[DeviceBinding]:
    """The devices of a bindings file on their fakes: for its mission, else with its own drivers."""
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
    """Problems of opening these devices on fakes, such as a watchdog that is too slow; on virtual time."""
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
    """Grammar rules name existing rules; character rules, in capitals, are partly prose and are skipped."""
    text = re.sub(r"\(\*.*?\*\)|'[^']*'|\"[^\"]+\"", "", block.text)
    text = re.split(r"^[A-Z]+ ", text, maxsplit=1, flags=re.MULTILINE)[0]
    rules = dict(re.findall(r"^(\w+)\s+=((?:.|\n(?!\w))*)", text, re.MULTILINE))
    used = {name for body in rules.values() for name in re.findall(r"\b[a-z]\w+\b", body)}
    return [f"there is no rule '{name}'" for name in sorted(used - rules.keys())]


def diagram(block: Block, folder: Path) -> Problems:
    """A state diagram of arrows with a label each."""
    head, *lines = block.text.splitlines()
    problems = [] if head == "stateDiagram-v2" else [f"there is no rule for a '{head}'"]
    return problems + [
        f"no arrow: {line}"
        for line in lines
        if not re.fullmatch(r"\s+(\w+|\[\*\]) --> (\w+|\[\*\]): .+", line)
    ]


def udev(block: Block, folder: Path) -> Problems:
    """Rules of udev: matches and assignments."""
    rule = re.compile(r'[A-Z]+(\{\w+\})?(==|=|\+=)"[^"]*"')
    return [
        f"no rule: {line}"
        for line in block.text.splitlines()
        if not all(map(rule.fullmatch, line.split(", ")))
    ]


def shell(block: Block, folder: Path) -> Problems:
    """Command lines of lfield parse, whether or not they are run here."""
    problems = []
    for line in shell_lines(block.text):
        for words in _COMMAND.findall(line):
            try:
                understand(words)
            except ValueError as error:
                problems.append(f"{line}: {error}")
    return problems


class Strict(argparse.ArgumentParser):
    """A parser that raises instead of ending the process, and takes no abbreviated options."""

    def __init__(self, **options: object) -> None:
        super().__init__(**{"prog": "lfield", **options, "allow_abbrev": False})  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def understand(line: str) -> None:
    """Parse a command line, without `lfield`, as the command would; raises ValueError."""
    name, *words = shlex.split(line, comments=True)
    if name not in COMMANDS:
        raise ValueError(f"there is no subcommand '{name}'")
    if name in ("sim", "kit") and {"lamp", "gps", "planner", "$name"}.intersection(words):
        # A driver that the preceding lines have made or installed.
        return
    parser = Strict()
    import_module(MODULES[name]).add_arguments(parser)
    parser.parse_args(words)


def wanted_status(line: str) -> int:
    """The expected status of a line."""
    said = _STATUS.search(line)
    return int(said[1]) if said else 0


#: By the first word behind the fence.
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
    """All errors of a block, each with its place."""
    check = CHECKS.get(block.language)
    if check is None:
        return [f"{block.place}: there is no rule for a block of '{block.info}'"]
    if block.file:
        (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
        (folder / block.file).write_text(block.text, encoding="utf-8")
    return [f"{block.place}: {problem}" for problem in check(block, folder)]


def missing_lines(wanted: str, said: str) -> Problems:
    """The lines of a block of output that were not printed; figures are ignored."""
    heard = {_plain(line) for line in said.splitlines()}
    lines = [line for line in wanted.splitlines() if line.strip() and line.strip() != "..."]
    return [
        f"was not printed: {line}"
        for line in lines
        if not line.startswith("$ ") and _plain(line) not in heard
    ]


def _plain(line: str) -> str:
    return re.sub(r"[0-9]+(\.[0-9]+)?|(?<==)[0-9a-f]{8,}", "#", re.sub(r" +", " ", line.strip()))
