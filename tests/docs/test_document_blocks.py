"""Every fenced block of every document is correct: programs compile, files are valid, command lines run."""

from __future__ import annotations

import io
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path

import pytest
from document_blocks import ROOT, Block, blocks_by_page, blocks_of, shell_lines, without_comment
from document_checks import expected_status, missing_lines, opened, problems_of
from document_exceptions import EXCEPTIONS, FILES
from msgspec import structs

from lfield.cli.main import main
from lfield.driver.binding import DeviceBinding
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission

pytestmark = pytest.mark.process

BLOCKS = blocks_by_page()
#: The devices files for simulators of real autopilots: a folder for each autopilot.
REAL = sorted((ROOT / "sim-adapters/real").rglob("*.devices.yaml"))
#: The maximum duration of a command line, in seconds.
TIMEOUT = 60.0
#: The characters at the end of an output that a failure shows.
SHOWN_OUTPUT = 3000
#: Subcommands that start no process; the tests call them in their own process.
IN_PROCESS = frozenset({"build", "capabilities", "check", "inspect", "keys", "plan", "query", "sign"})
_RUNS: dict[str, tuple[int | str, str]] = {}
#: Pages whose lines run for several seconds. Tests in the folders of the examples run the same missions in
#: virtual time, the README runs the mission of examples/10-client-server in processes, and getting-started.md
#: runs `lfield test`.
SLOW_PAGES = {
    *(
        f"examples/{name}/README.md"
        for name in ("07-so101-arm", "11-multiple-tiers", "12-peer-to-peer", "15-tuple-space", "17-learning")
    ),
    "lfield/docs/testing.md",
}
#: Folders of the repository that commands of the documents name.
NAMED = ("examples", "deploy", "capabilities")


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    """A folder for the command lines, with copies of the folders that the documents name."""
    for folder in NAMED:
        shutil.copytree(ROOT / folder, tmp_path / folder)
    return tmp_path


def prepare(page: str, folder: Path) -> None:
    """Write the files that a page names, and the files that it shows."""
    for name, source in FILES.get(page, {}).items():
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / source, folder / name)
    for block in BLOCKS[page]:
        if block.file:
            (folder / block.file).parent.mkdir(exist_ok=True)
            (folder / block.file).write_text(block.text, encoding="utf-8")


def run(line: str, folder: Path) -> tuple[int | str, str]:
    """Run a command line. Return its exit status and its output."""
    commands = [shlex.split(each, comments=True) for each in line.split(" && ")]
    if all(words[0] == "lfield" and words[1] in IN_PROCESS for words in commands):
        return run_here(commands, folder)
    # A line that needs no file of the page runs once for all pages.
    known = without_comment(line)
    if not known.startswith("lfield up --deploy examples/"):
        return run_in_shell(line, folder)
    if known not in _RUNS:
        _RUNS[known] = run_in_shell(line, folder)
    return _RUNS[known]


def run_here(commands: list[list[str]], folder: Path) -> tuple[int | str, str]:
    """Run commands of lfield in this process. Stop at the first one that fails."""
    output = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(output), redirect_stderr(output):
        patch.chdir(folder)
        patch.setenv("HOME", str(folder))
        patch.setenv("XDG_CONFIG_HOME", str(folder / ".config"))
        for _, *words in commands:
            if status := main([str(Path(word).expanduser()) for word in words]):
                break
    return status, output.getvalue()


def run_in_shell(line: str, folder: Path) -> tuple[int | str, str]:
    """Run a command line in a shell, and then end the remaining processes of the line."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    with tempfile.TemporaryFile() as output:
        shell = subprocess.Popen(
            ["bash", "-c", line], cwd=folder, env={**os.environ, "PATH": path, "HOME": str(folder),
                 "XDG_CONFIG_HOME": str(folder / ".config")},
            stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            status = shell.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            status = "it did not end"
        finally:
            with suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGTERM)
            shell.wait(TIMEOUT)
        output.seek(0)
        return status, output.read().decode("utf-8", "replace")


def is_output(block: Block) -> bool:
    """Whether the block shows output."""
    return block.info == "text output"


def lines_of(block: Block) -> list[str]:
    """The command lines of a block. A block of output may have command lines too."""
    if is_output(block):
        return shell_lines("\n".join(line for line in block.text.splitlines() if line.startswith("$ ")))
    return shell_lines(block.text) if block.language == "sh" else []


def differences(page: str, folder: Path) -> list[str]:
    """Run the lines of a page in order. Return the differences from the page."""
    problems, output, skipped = [], "", EXCEPTIONS.get(page, {})
    for block in BLOCKS[page]:
        lines = lines_of(block)
        output = "" if lines else output
        for line in lines:
            if without_comment(line) not in skipped:
                status, printed = run(line, folder)
                output += printed
                if status != expected_status(line):
                    problems.append(f"{block.place}: {line}: status {status}: {printed}")
        if not is_output(block) or block.text.splitlines()[0] in skipped:
            continue
        if missing := missing_lines(block.text, output):
            problems += [f"{block.place}: {each}" for each in missing]
            problems.append(f"{block.place}: the end of the output:\n{output[-SHOWN_OUTPUT:]}")
    return problems


@pytest.mark.parametrize("page", BLOCKS)
def test_every_block_is_valid(page: str, scratch: Path) -> None:
    prepare(page, scratch)
    problems = [problem for block in BLOCKS[page] for problem in problems_of(block, scratch)]
    assert not problems, "\n".join(problems)


PAGES_WITH_LINES = [page for page, blocks in BLOCKS.items() if any(map(lines_of, blocks))]


def check_lines(page: str, folder: Path) -> None:
    prepare(page, folder)
    problems = differences(page, folder)
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("page", [page for page in PAGES_WITH_LINES if page not in SLOW_PAGES])
def test_every_line_runs(page: str, scratch: Path) -> None:
    check_lines(page, scratch)


@pytest.mark.few(0)
@pytest.mark.parametrize("page", sorted(SLOW_PAGES))
def test_every_line_of_a_slow_page_runs(page: str, scratch: Path) -> None:
    check_lines(page, scratch)


@pytest.mark.parametrize("page", EXCEPTIONS)
def test_every_exception_is_on_its_page(page: str) -> None:
    on_page = {without_comment(line) for block in BLOCKS.get(page, []) for line in lines_of(block)}
    on_page |= {block.text.splitlines()[0] for block in BLOCKS.get(page, []) if is_output(block)}
    assert sorted(EXCEPTIONS[page].keys() - on_page) == []


@pytest.mark.parametrize(
    "devices", sorted((ROOT / "deploy").rglob("*.devices.yaml")), ids=lambda p: p.parent.name
)
def test_sample_bindings_open(devices: Path) -> None:
    program = ROOT / "examples/01-first-flight/mission.L"
    mission = load_mission(devices.with_name("mission.dL"), program, devices, simulate=True)
    assert opened(mission.bindings.all) == []


@pytest.mark.parametrize("devices", REAL, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_bindings_of_real_autopilots_differ_in_endpoints_only(devices: Path) -> None:
    deployment = ROOT / "examples" / devices.name.removesuffix(".devices.yaml") / "mission.dL"
    real, example = load_mission(deployment, devices=devices), load_mission(deployment)

    def without_endpoints(mission: Mission) -> list[DeviceBinding]:
        return [structs.replace(device, endpoint="", frame=None, sim=[]) for device in mission.bindings.all]

    assert without_endpoints(real) == without_endpoints(example)
    assert {d.endpoint for d in real.bindings.all}.isdisjoint(d.endpoint for d in example.bindings.all)


# --- tests of the block checker -----------------------------------------------------------------------

PAGE = """\
```java
class A { }
```
1. ~~~text output
   indented
   ~~~

   ````yaml
   a: |
     ```
   ````
> ```sh
> one \\
>   two
> $ three   # status 65
> # four
> ```
```
without a closing fence
"""


def test_every_kind_of_fence_is_found() -> None:
    found = list(blocks_of("page.md", PAGE))
    assert [(block.line, block.info) for block in found] == [
        (1, "java"),
        (4, "text output"),
        (8, "yaml"),
        (12, "sh"),
        (18, ""),
    ]
    assert found[1].text == "indented\n"
    assert found[2].text == "a: |\n  ```\n"
    assert [" ".join(line.split()) for line in shell_lines(found[3].text)] == ["one two", "three # status 65"]
    assert expected_status("three # status 65") == 65
    assert found[4].text == "without a closing fence\n"


@pytest.mark.parametrize(
    ("info", "text", "words"),
    [
        ("", "", "there is no rule for a block of ''"),
        ("cobol", "", "there is no rule for a block of 'cobol'"),
        ("text", "", "there is no rule for 'text'"),
        ("java fragment", "", "there is no rule for 'java fragment'"),
        ("java", "coordinator C { init(string[] arg) { print(x); } }\n", "error[L"),
        ("java a.L wrong", "class A { }\n", "an error is expected"),
        ("java statements of Mavlink fc", "fc.fly(new real[] {1.0});\n", "error[L"),
        ("text a.dL", "//A\n", "error[L7"),
        ("yaml", "registry: 1\nprimitive: {}\n", "error["),
        (
            "yaml",
            "agents: {a: {devices: {fc: {driver: mavlink, endpoint: 'tcp:h:1', wings: 2}}}}\n",
            "'wings'",
        ),
        (
            "yaml device",
            "fc: {driver: mavlink, endpoint: 'tcp:h:1', limits: {speed: 5.0}}\n",
            "watchdog too slow: 2 s",
        ),
        ("yaml", "agents: {a: [\n", "no YAML"),
        ("yaml", "agents\n", "neither a mapping nor a list"),
        ("yaml options mavlink", "wings: 2\n", "'wings'"),
        ("json", "{", "Expecting"),
        ("python", "def", "invalid syntax"),
        ("ebnf", 'rule = "b" other ;\nNAME = letter ;\n', "no rule 'other'"),
        ("mermaid", "stateDiagram-v2\n  A -> B\n", "no arrow"),
        ("udev", "SUBSYSTEM=tty\n", "no rule"),
        ("sh", "lfield fly\n", "there is no subcommand 'fly'"),
        ("sh", "lfield up m.dL --everything\n", "unrecognized arguments"),
        ("sh", "cd x && lfield ps m.dL n.dL\n", "unrecognized arguments"),
    ],
)
def test_invalid_block_is_found(tmp_path: Path, info: str, text: str, words: str) -> None:
    problems = problems_of(Block("page.md", 7, info, text), tmp_path)
    assert problems
    assert problems[0].startswith("page.md:7: ")
    assert words in "\n".join(problems)


def test_missing_output_is_found() -> None:
    assert missing_lines("a 12 b\n...\nc\n", "a 7.5  b\nd\n") == ["was not printed: c"]
