"""The cached machine code of a program: found again, compiled again when damaged, never that of others."""

from __future__ import annotations

import ast
import os
import platform
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from lfield.errors import UsageError
from lfield.host import engine_provider as engines_module
from lfield.host.engine_provider import MAX_PROGRAMS, UserCodeCache, code_folder, select_engine
from lfield.operator.diagnostics import engine
from lfield.testing.golden import compile_text
from lfield.vm.reference import ReferenceEngine as Reference
from switching_engine import NEEDED

_NOBODY = 65534
PROGRAM = compile_text("resource R { init(string[] arg) { print(arg.length() + 1); } }")


@pytest.fixture
def cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder, and no code in this process."""
    pytest.importorskip("wasmtime", reason=NEEDED)
    from lfield.vm.wasm import machine_code

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine_code._recent.clear()
    return code_folder()


def made(notes: list[str]) -> dict[int, int]:
    """The points of the program on a new engine, as in a new process."""
    from lfield.vm.wasm import machine_code
    from lfield.vm.wasm.wasm_engine import WasmEngine

    machine_code._recent.clear()
    engine = select_engine("wasm", notes.append)(PROGRAM, float)
    assert isinstance(engine, WasmEngine)
    return engine.points


@contextmanager
def other_user() -> Iterator[None]:
    """Run as another user if the tests run as root, who may read everything."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(_NOBODY)
    try:
        yield
    finally:
        os.seteuid(user)


def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """Require that code is found in the cache."""

    def refuse(*_: object) -> None:
        raise AssertionError("it was compiled again")

    monkeypatch.setattr("lfield.vm.wasm.machine_code.lower_program", refuse)


def test_cached_code_is_found_again(cached: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []
    first = made(notes)
    assert all(path.stat().st_mode & 0o077 == 0 for path in [cached, *cached.iterdir()])
    no_compiler(monkeypatch)
    assert made(notes) == first
    assert notes == []


@pytest.mark.few(1)
@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "other"])
def test_damaged_code_is_compiled_again_with_one_line(cached: Path, damage: str) -> None:
    notes: list[str] = []
    first = made(notes)
    for path in cached.iterdir():
        data = bytearray(path.read_bytes())
        match damage:
            case "cut":
                del data[len(data) // 2 :]
            case "changed":
                data[-100] ^= 1
            case "empty":
                data.clear()
            case _:
                data[:] = os.urandom(len(data))
        path.write_bytes(data)
    assert len(list(cached.iterdir())) == 2
    assert made(notes) == first
    assert len(notes) == 1
    assert notes[0].startswith("machine code compiled again: ")
    assert made(notes) == first
    assert len(notes) == 1


def test_code_that_others_may_write_is_not_used(cached: Path) -> None:
    notes: list[str] = []
    first = made(notes)
    for path in cached.iterdir():
        path.chmod(0o666)
    assert made(notes) == first
    assert notes
    assert all("others may write to it" in note for note in notes)


def test_a_service_has_its_own_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CACHE_DIRECTORY", "/var/cache/lfield:/var/cache/other")
    assert code_folder() == Path("/var/cache/lfield/code")


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["file", "x" * 300, "file/below", "loop"])
def test_without_a_cache_folder_everything_is_compiled(
    cached: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "loop").symlink_to("loop")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / name))
    assert made([])


@pytest.mark.parametrize("home", ["", "relative"])
def test_without_a_home_everything_is_compiled(
    cached: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    (working := tmp_path / "working").mkdir()
    monkeypatch.chdir(working)
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(os, "getuid", lambda: 54321)  # not a user of this computer
    assert code_folder() is None
    assert made([])
    assert list(working.iterdir()) == []


def test_an_unreadable_cache_folder_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "others").mkdir(mode=0)
    notes: list[str] = []
    cache = UserCodeCache(tmp_path / "others" / "lfield" / "code", notes.append)
    with other_user():
        cache.put("name", b"x")
        assert cache.get("name") is None
    assert [note.rpartition(": ")[2] for note in notes] == ["Permission denied"]


def test_the_name_of_code_depends_on_program_reservation_processor_and_versions(
    cached: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lfield.vm.wasm import machine_code

    names = {machine_code.name_of(digest, reservation) for digest in (b"a", b"b") for reservation in (1, 2)}
    monkeypatch.setattr(machine_code, "version", lambda _: "0.1")
    names.add(machine_code.name_of(b"a", 1))
    monkeypatch.setattr(machine_code, "_makers", lambda: b"another lfield")
    names.add(machine_code.name_of(b"a", 1))
    monkeypatch.setattr(machine_code.platform, "machine", lambda: "another processor")
    names.add(machine_code.name_of(b"a", 1))
    assert len(names) == 7


def test_the_oldest_code_is_removed(tmp_path: Path) -> None:
    cache = UserCodeCache(tmp_path, print)
    for number in range(MAX_PROGRAMS + 3):
        cache.put(f"{number:03}", b"x")
        os.utime(tmp_path / f"{number:03}", (number, number))
    cache.put("last", b"x")
    assert len(list(tmp_path.iterdir())) == MAX_PROGRAMS
    assert cache.get("last") == b"x"
    assert cache.get("000") is None


def test_without_wasmtime_the_reference_engine_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines_module, "has_wasm", lambda: False)
    assert select_engine("auto", print) is Reference
    assert select_engine("reference", print) is Reference
    with pytest.raises(UsageError, match="pip install"):
        select_engine("wasm", print)


def test_an_unusable_wasmtime_is_logged_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines_module, "has_wasm", lambda: True)
    monkeypatch.setitem(sys.modules, "lfield.vm.wasm.wasm_engine", None)
    notes: list[str] = []
    assert isinstance(select_engine("auto", notes.append)(PROGRAM, float), Reference)
    assert notes[0].startswith("the reference engine runs the program: wasmtime cannot be used: ")
    with pytest.raises(UsageError, match="cannot be used"):
        select_engine("wasm", notes.append)(PROGRAM, float)


#: A host's engine for a program, with another processor name.
_ELSEWHERE = """
import platform, sys
platform.machine = lambda: sys.argv[1]
from lfield.host.engine_provider import select_engine
from lfield.testing.golden import compile_text
program = compile_text("resource R { init(string[] arg) { } }")
print(select_engine("auto", print)(program, float).__class__.__module__)
"""


@pytest.mark.process
def test_an_unsupported_processor_selects_the_reference_engine(tmp_path: Path) -> None:
    """The wheel for all platforms installs anywhere, and fails only when it is loaded."""
    pytest.importorskip("wasmtime", reason=NEEDED)
    done = _elsewhere(tmp_path, "riscv64")
    assert done.stdout.splitlines() == [
        "the reference engine runs the program: wasmtime cannot be used: "
        "unsupported architecture for wasmtime: riscv64",
        "lfield.vm.reference.reference_engine",
    ]


def _elsewhere(cache: Path, machine: str, addresses: int = 0) -> subprocess.CompletedProcess[str]:
    prepare = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({addresses},) * 2)" if addresses else ""
    )
    return subprocess.run(
        [sys.executable, "-c", prepare + _ELSEWHERE, machine],
        env=os.environ | {"XDG_CACHE_HOME": str(cache)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )


@pytest.mark.few(0)
@pytest.mark.process
def test_with_few_addresses_the_second_start_finds_the_code_too(tmp_path: Path) -> None:
    pytest.importorskip("wasmtime", reason=NEEDED)
    for _ in range(2):
        done = _elsewhere(tmp_path, platform.machine(), 300 << 20)
        assert done.stdout.splitlines() == ["lfield.vm.wasm.wasm_engine"]


def test_code_under_a_wrong_name_is_compiled_again(cached: Path) -> None:
    """Valid, of the same lfield and wasmtime, but of another program."""
    notes: list[str] = []
    first = made(notes)
    one, other = sorted(cached.iterdir())
    one_data = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(one_data)
    assert made(notes) == first
    assert [note.rpartition(": ")[2] for note in notes] == ["its header does not match its name or content"]


def test_the_name_of_code_covers_all_modules_that_make_it() -> None:
    pytest.importorskip("wasmtime", reason=NEEDED)
    from lfield.vm.wasm.machine_code import _MAKERS, _NO_MAKERS

    makers = _imported("lfield.vm.wasm.lowering.module_lowering") | _imported(
        "lfield.vm.wasm.runtime.runtime_functions"
    )
    assert {"lfield.vm.wasm.lowering.instruction_table", "lfield.vm.reference.step_compiler"} < makers
    covered = tuple(f"{name}." for name in (*_MAKERS, *_NO_MAKERS))
    assert [name for name in sorted(makers) if not f"{name}.".startswith(covered)] == []


def _imported(root: str) -> set[str]:
    """The modules of lfield that one imports, directly and indirectly; packages only with their files."""
    found: set[str] = set()
    pending = [root]
    while pending:
        name = pending.pop()
        path = _file_of(name)
        if path is None or name in found:
            continue
        found.add(name)
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                pending += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                pending += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


def _file_of(name: str) -> Path | None:
    """The file of a module of lfield, None for any other name."""
    path = Path(__file__).parents[3].joinpath(*name.split("."))
    files = [path.with_suffix(".py"), path / "__init__.py"] if name.startswith("lfield.") else []
    return next((file for file in files if file.is_file()), None)


@pytest.fixture
def old_wasmtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """From the call on, the configuration of wasmtime lacks a setting, which Python permits to set."""
    wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)
    from lfield.vm.wasm import machine_code, wasm_compiler

    def forget() -> None:
        wasm_compiler.compiler.cache_clear()
        machine_code._recent.clear()

    def remove_option(name: str) -> None:
        left_out = ("__dict__", "__weakref__", name)
        known = {key: value for key, value in vars(wasmtime.Config).items() if key not in left_out}
        monkeypatch.setattr(wasmtime, "Config", type("Config", wasmtime.Config.__bases__, known))
        forget()

    yield remove_option
    forget()


@pytest.mark.parametrize(
    "setting",
    [
        "memory_reservation",
        "memory_reservation_for_growth",
        "memory_may_move",
        "wasm_wide_arithmetic",
        "cranelift_nan_canonicalization",
        "parallel_compilation",
        "max_wasm_stack",
    ],
)
def test_a_wasmtime_without_a_needed_setting_is_not_used(
    setting: str, old_wasmtime: Callable[[str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    old_wasmtime(setting)
    notes: list[str] = []
    assert isinstance(select_engine("auto", notes.append)(PROGRAM, float), Reference)
    assert notes == [
        "the reference engine runs the program: wasmtime cannot be used: "
        f"it has no setting {setting}; lfield needs version 50"
    ]
    assert engine().state == "warning"
    with pytest.raises(UsageError, match="needs version 50"):
        select_engine("wasm", notes.append)(PROGRAM, float)


def test_the_required_version_is_that_of_the_project() -> None:
    pytest.importorskip("wasmtime", reason=NEEDED)
    from lfield.vm.wasm.wasm_compiler import VERSION

    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))
    (requirement,) = project["project"]["optional-dependencies"]["wasm"]
    assert requirement.startswith(f"wasmtime>={VERSION},<{VERSION + 1};")
