"""Rules of STYLE.md on files, folders, functions and names, applied to the code."""

from __future__ import annotations

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: Packages of the tests that follow the rules of the product.
TOOLS = ("tests/fuzz/engine_fuzzer", "tests/simulate/simulation_testing")
PRODUCT = ("lfield", "drivers", "sim-adapters", *TOOLS)
EVERYTHING = ("lfield", "drivers", "sim-adapters", "tests", "examples")

MOST_FILES, MOST_LINES, LEAST_LINES, LONGEST_FUNCTION = 14, 400, 60, 60

#: File names that may repeat: pytest distinguishes them, or they are not imported.
NAMESAKES = ("conftest.py", "run.py")

#: Files that may be longer, with the reason: tables for lookup.
TABLES: dict[str, str] = {
    "lfield/errors.py": "the exceptions of all packages, one tree",
    "lfield/bytecode/opcodes.py": "the instructions, by their codes",
    "lfield/lang/tree.py": "the nodes of the checked tree, which refer to each other",
}
#: Files that may be shorter: each is one separate subject.
SMALL = {
    "lfield/client/event_json.py": "events as JSON, for commands and clients",
    "lfield/host/person_calls/call_limits.py": "limits on the calls of persons, without I/O",
    "lfield/testing/mission/double_answers.py": "special results of doubles",
    "lfield/mission/checks/recovery_findings.py": "findings about recovery that need two files",
    "lfield/host/events/path_rate.py": "a separate measurement, without I/O",
    "lfield/net/coding/link_compression.py": "two streams of zlib",
    "lfield/inventory/location.py": "the selection of the inventory, without YAML",
    "lfield/service/messages.py": "the log lines of the service",
    "lfield/service/restart_policy.py": "the rule for restarts of hosts, without I/O",
    "drivers/lfield_dynamixel/log_messages.py": "the log lines of a driver",
    "drivers/lfield_mavlink/link/link_events.py": "the reports of a link to its driver",
    "lfield/authority/key_material.py": "keys as bytes, and the names of their files",
    "lfield/authority/ephemeral_ca.py": "keys of one run, in memory",
    "lfield/authority/web_ca/web_certificates.py": "the paths of pages in the folder of an authority",
    "lfield/lang/parser/concurrency.py": "statements whose keywords are names elsewhere",
    "lfield/wire/reservation_messages.py": "all messages about reservations",
    "lfield/capability/realisations.py": "names that compiler and machine share",
    "lfield/clock.py": "the clock protocol of all packages",
    "lfield/devices/jitter_measurement.py": "the I/O of the jitter measurement",
    "lfield/operator/web/page.py": "the only page of the only component",
    "lfield/operator/dashboard/event_stream/background_task.py": "failures of background tasks",
    "lfield/host/process/shutdown_signals.py": "the signals that end a host",
    "lfield/host/failures/agent_dump.py": "the file for the block of a failed agent",
    "lfield/net/connections/socket_errors.py": "the meanings of socket errors, a table",
    "lfield/net/scheduling/temporary_bans.py": "the back-off of a member that sent too much",
    "lfield/net/fault_client.py": "the client of a fake's fault port",
    "tests/simulate/simulation_testing/invariants/breaches.py": "the reports of all invariants",
    "tests/simulate/simulation_testing/invariants/durability.py": "the durability of simulated journals",
    "lfield/simulate/jumping_loop.py": "the event loop with virtual time",
    "lfield/testing/still_team.py": "a team for golden programs",
    "lfield/testing/script.py": "errors of scripts that run missions under test",
    "lfield/testing/kept_reports.py": "the receiver of a driver's reports, for tests",
    "lfield/text/number_arguments.py": "three types of options",
    "lfield/text/value_text.py": "values of devices as text",
    "lfield/vm/maths/intrinsics.py": "instructions and their functions, a table",
    "lfield/vm/wasm/engine_selection.py": "the available engines, without wasmtime",
    "lfield/vm/wasm/native_calls.py": "the calls from Python to WebAssembly",
    "lfield/vm/wasm/runtime/runtime_functions.py": "the runtime's text and its functions",
    "lfield/vm/memory/serialised_results.py": "results that wait for their await, as bytes",
}


#: Documented names with an underscore: of named tuples, python-can, asyncio for event loops, and wasmtime
#: for calls without its conversions.
DOCUMENTED = {
    *("_replace", "_asdict", "_recv_internal", "_get_running_loop", "_set_running_loop"),
    *("_context", "_func", "_from_ptr"),
}


def files(*folders: str) -> list[Path]:
    """All Python files of some folders of the project."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def seen_in(path: Path) -> tuple[dict[str, int], list[str]]:
    """The lengths of a file's functions, and its uses of private names of other files, without its tree."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    return functions(nodes), [f"{name_of(path)}:{line}: {name}" for line, name in private_uses(nodes)]


def length(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_no_folder_has_more_than_14_files() -> None:
    counts = {}
    for path in files(*EVERYTHING):
        counts[name_of(path.parent)] = counts.get(name_of(path.parent), 0) + 1
    assert {folder: count for folder, count in counts.items() if count > MOST_FILES} == {}


def test_test_file_names_are_unique() -> None:
    """pytest imports test files and their helpers by bare names: of two equal names it uses only one.

    Files in a package are imported with the name of the package.
    """
    bare = (path for path in files("tests", "examples") if not (path.parent / "__init__.py").is_file())
    names = Counter(path.name for path in bare if path.name not in NAMESAKES)
    assert [name for name, count in names.items() if count > 1] == []


def test_file_has_60_to_400_lines() -> None:
    """Package inits and commands may be shorter."""
    lengths = {name_of(path): length(path) for path in files(*PRODUCT)}
    long = {name: lines for name, lines in lengths.items() if lines > MOST_LINES and name not in TABLES}
    assert long == {}
    short = {name: lines for name, lines in lengths.items() if lines < LEAST_LINES and not may_be_short(name)}
    assert short == {}


def may_be_short(name: str) -> bool:
    """True for a package init, an entry module, a command, and the files of the table."""
    return (
        Path(name).name in ("__init__.py", "__main__.py") or name.startswith("lfield/cli/") or name in SMALL
    )


def test_exception_tables_name_no_file_without_need() -> None:
    assert [name for name in TABLES if length(ROOT / name) <= MOST_LINES] == []
    assert [name for name in SMALL if length(ROOT / name) >= LEAST_LINES] == []


def test_function_has_at_most_60_lines() -> None:
    found = {f"{name_of(path)}:{name}": n for path in files(*PRODUCT) for name, n in seen_in(path)[0].items()}
    assert {name: lines for name, lines in found.items() if lines > LONGEST_FUNCTION} == {}


def functions(nodes: list[ast.AST]) -> dict[str, int]:
    """The longest function of each name."""
    found: dict[str, int] = {}
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            lines = node.end_lineno - node.lineno + 1
            found[node.name] = max(lines, found.get(node.name, 0))
    return found


def private_uses(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    """Lines that use a private name that is defined in another file."""
    own = {node.attr for node in nodes if isinstance(node, ast.Attribute) and of_self(node)}
    own |= DOCUMENTED | {n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}
    for node in nodes:
        if isinstance(node, ast.Attribute) and private(node.attr) and node.attr not in own:
            yield node.lineno, node.attr
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lfield"):
            for alias in node.names:
                if private(alias.name):
                    yield node.lineno, alias.name


def of_self(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")


def private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


@pytest.mark.parametrize("path", files(*PRODUCT), ids=name_of)
def test_no_file_uses_private_names_of_another_file(path: Path) -> None:
    assert seen_in(path)[1] == []


#: First words of a docstring that do not name its subject.
HIDDEN_SUBJECT = re.compile(
    r'^ *r?"""(?:It|Its|They|Their|That|There|Here|Nothing|What|Whether (?:it|its|they))\b.*', re.M
)


def test_no_docstring_begins_without_a_subject() -> None:
    paths = files("lfield", "drivers", "sim-adapters", "tests")
    texts = {path: path.read_text(encoding="utf-8") for path in paths}
    assert [
        f"{name_of(path)}: {line}" for path in texts for line in HIDDEN_SUBJECT.findall(texts[path])
    ] == []


#: A comment that switches a check off, without a reason behind it.
SILENCED = re.compile(r"# (?:type: ignore\[[\w, -]+\]|noqa: [A-Z0-9, ]+)$")


def test_ignored_findings_have_a_reason_beside_or_above() -> None:
    found = []
    for path in files("lfield", "drivers", "sim-adapters", "examples"):
        lines = ["", "", *path.read_text(encoding="utf-8").splitlines()]
        found += [
            f"{name_of(path)}: {line.strip()}"
            for above, before, line in zip(lines, lines[1:], lines[2:], strict=False)
            if SILENCED.search(line) and not any(each.lstrip().startswith("#") for each in (above, before))
        ]
    assert found == []


#: Constants of other programs: Linux, getconf, OpenSSL, uv, MAVLink.
FOREIGN_CONSTANTS = {
    *("TCP_NOTSENT_LOWAT", "TIME_WAIT", "PIPE_BUF", "AF_CAN", "X509_V_FLAG_NO_CHECK_TIME"),
    *("UV_PYTHON_DOWNLOADS_JSON_URL", "LONG_BIT", "GNU_LIBC_VERSION", "PRETTY_NAME"),
    *("CHANGE_OPERATOR_CONTROL", "AUTH_KEY", "SETUP_SIGNING", "WIFI_CONFIG_AP"),
}
#: A docstring or a comment, and a constant with an underscore.
PROSE, CONSTANT = re.compile(r'"""[\s\S]*?"""|#.*'), re.compile(r"\b[A-Z][A-Z0-9]*_[A-Z0-9_]+\b")


def test_constants_in_docstrings_and_comments_exist() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in files("lfield")}
    defined = {name.strip("_") for text in texts.values() for name in re.findall(r"\w+", PROSE.sub("", text))}
    assert [
        f"{name_of(path)}: {name}"
        for path, text in texts.items()
        for prose in PROSE.findall(text)
        for name in CONSTANT.findall(prose)
        if name.strip("_") not in defined | FOREIGN_CONSTANTS
    ] == []


#: Files outside the wire and the host that may read the snapshot of a host. All others use the read model.
SNAPSHOT_READERS = {
    "lfield/operator/client.py",
    "lfield/operator/team_model/host_model.py",
    "lfield/operator/team_model/mission_end.py",
    "lfield/operator/team_model/team_view.py",
    "lfield/operator/team_model/team_state.py",
}


def test_only_the_read_model_reads_the_snapshot_of_a_host() -> None:
    readers = {
        name_of(path)
        for path in files("lfield")
        if "Status" in (text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and "Status" in {alias.name for alias in node.names}
    }
    own = ("lfield/wire/", "lfield/host/")
    assert {name for name in readers if not name.startswith(own)} == SNAPSHOT_READERS


#: Files that may subscribe to a host: the clients of observers. Hosts use `Locate` among themselves.
SUBSCRIBERS = {"lfield/operator/client.py", "lfield/operator/dashboard/event_stream/stream_cursor.py"}


def test_only_clients_of_observers_subscribe_to_a_host() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in files("lfield")}
    asking = {
        name_of(path)
        for path, text in texts.items()
        if "Subscribe(" in text
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] == "Subscribe"
    }
    assert asking == SUBSCRIBERS


def test_only_the_core_creates_parts_and_all_are_in_the_contract() -> None:
    host = {path: path.read_text(encoding="utf-8") for path in (ROOT / "lfield/host").rglob("*.py")}
    modules = {path: re.findall(r"^class (\w+)\(Part\)", text, re.M) for path, text in host.items()}
    parts = [part for found in modules.values() for part in found]
    assert len(parts) > 10
    created = re.compile(rf"\b(?:{'|'.join(parts)})\((?!Part\))")
    assert [path.name for path, text in host.items() if created.search(text)] == ["core.py"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (contract,) = (one for one in contracts if one["name"].startswith("The parts of a host"))
    names = {name_of(path)[:-3].replace("/", ".") for path, found in modules.items() if found}
    assert names <= set(contract["modules"])
