"""The process that compiles a host's program: its cost and its failures do not affect the host."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from lfield.errors import EngineUnavailable, UsageError
from lfield.host import engine_provider
from lfield.host.engine_provider import compile_in_process, select_engine
from lfield.testing.golden import compile_text
from lfield.vm.reference import ReferenceEngine as Reference
from switching_engine import NEEDED

pytestmark = pytest.mark.process
PROGRAM = compile_text("resource R { init(string[] arg) { print(arg.length() + 1); } }")
WHOLE = 1 << 32
Ends = Callable[[str], None]


@pytest.fixture(autouse=True)
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty cache folder, and no code in this process, which refuses to compile."""
    wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)
    from lfield.vm.wasm import machine_code

    def refuse(*_: object) -> None:
        raise AssertionError("the host itself compiles")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(wasmtime.Module, "__init__", refuse)
    machine_code._recent.clear()


@pytest.fixture
def ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Ends:
    """Replaces the compiler process by a script."""

    def ends(script: str) -> None:
        (tmp_path / "python").write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / "python").chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))

    return ends


def started(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The commands that are started from now on."""
    commands: list[str] = []
    run = subprocess.run

    def run_recorded(command, **options):
        commands.append(command)
        return run(command, **options)

    monkeypatch.setattr(subprocess, "run", run_recorded)
    return commands


def engine_of(notes: list[str], choice: str = "auto") -> object:
    return select_engine(choice, notes.append)(PROGRAM, float)


def test_one_process_compiles_program_and_runtime_and_none_cached_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from lfield.vm.wasm import machine_code

    commands, notes = started(monkeypatch), []
    assert not isinstance(engine_of(notes), Reference)
    assert len(commands) == 1
    machine_code._recent.clear()
    assert not isinstance(engine_of(notes), Reference)
    assert len(commands) == 1
    assert notes == []


def test_without_a_cache_folder_the_code_comes_over_the_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "")
    monkeypatch.setattr(os, "getuid", lambda: 54321)  # no user of this computer
    commands, notes = started(monkeypatch), []
    assert not isinstance(engine_of(notes), Reference)
    assert len(commands) == 1
    assert notes == []


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("kill -9 $$", "was ended by signal 9"),
        ("echo no memory >&2; kill -ABRT $$", "was ended by signal 6: no memory"),
        ("echo why >&2; echo it >&2; exit 3", "ended with status 3: it"),
        ("exit 0", "gave no machine code"),
        ("echo 5 7; printf short", "gave no machine code"),
        ("echo five; printf words", "gave no machine code"),
    ],
)
def test_a_dead_compiler_selects_the_reference_engine_with_one_line(
    ends: Ends, script: str, why: str
) -> None:
    ends(script)
    notes: list[str] = []
    assert isinstance(engine_of(notes), Reference)
    assert notes == [
        f"the reference engine runs the program: wasmtime cannot be used: its process that compiles {why}"
    ]
    with pytest.raises(UsageError, match=why):
        engine_of(notes, "wasm")


def test_a_compiler_that_cannot_start_selects_the_reference_engine(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "nothing"))
    notes: list[str] = []
    assert isinstance(engine_of(notes), Reference)
    assert len(notes) == 1
    assert "its process that compiles could not start: " in notes[0]


def test_a_start_does_not_wait_without_limit_for_the_compiler(ends: Ends) -> None:
    ends("exec sleep 600")
    with pytest.raises(EngineUnavailable, match=r"its process that compiles took longer than 0\.1 s"):
        compile_in_process(["(module)"], WHOLE, 0.1)


def test_a_compiler_error_is_reported_with_its_reason() -> None:
    with pytest.raises(EngineUnavailable, match="ended with status 1: "):
        compile_in_process(["(module (nonsense))"], WHOLE)


def test_modules_in_the_working_folder_are_not_imported_by_the_compiler(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "wasmtime.py").write_text("raise SystemExit('foreign module')")
    monkeypatch.chdir(tmp_path)
    (code,) = compile_in_process(["(module)"], WHOLE)
    assert code.startswith(b"\x7fELF")


#: A host that starts its compiler, with its own streams, and then sleeps.
_HOST = """
import os, subprocess, sys, time
command = [sys.executable, "-P", "-m", sys.argv[1], str(1 << 32), str(os.getpid())]
subprocess.Popen(command)
time.sleep(600)
"""


def test_the_compiler_ends_with_its_host() -> None:
    """With any kind of end. Its input stays open, so the end of the input does not end it."""
    command = [sys.executable, "-c", _HOST, engine_provider._COMPILER]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as host:
        assert host.stdout is not None
        while not Path(f"/proc/{host.pid}/task/{host.pid}/children").read_text():
            os.sched_yield()
        host.send_signal(signal.SIGKILL)
        # Both processes have the other end.
        assert host.stdout.read() == b""
