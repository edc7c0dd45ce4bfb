"""The time of a compilation is linear in the size of the program, and no garbage collection delays it."""

from __future__ import annotations

import gc
from collections.abc import Callable

import pytest

from lfield.errors import ProgramError
from lfield.mission.loader import compile_file
from lfield.testing.golden import compile_text


def _inside(body: str) -> str:
    return f"resource Part {{ init(string[] arg) {{ int x = 0; {body} }} }}"


def _members(members: str) -> str:
    return f"resource Part {{ init(string[] arg) {{ }} {members} }}"


#: By kind of part: a program of n parts.
SHAPES: dict[str, Callable[[int], str]] = {
    "statements": lambda n: _inside("".join(f"x = x * 3 + {i};\n" for i in range(n))),
    "one sum": lambda n: _inside("x = x" + "".join(f"\n+ {i}" for i in range(n)) + ";"),
    "else if": lambda n: _inside("".join(f"if (x == {i}) x = 1;\nelse " for i in range(n)) + "x = 2;"),
    "loops": lambda n: _inside("".join(f"while (x < {i}) {{ if (x == 7) break; x++; }}\n" for i in range(n)))
    .replace("x++", "x = x + 1"),
    "tries": lambda n: _inside("".join(f"try {{ x = {i}; }} catch (Exception e) {{ }}\n" for i in range(n))),
    "methods": lambda n: _members(
        "".join(f"private int m{i}(int a) {{ return m{(i + 1) % n}(a); }}\n" for i in range(n))
    ),
    "fields": lambda n: _members("".join(f"int f{i}; portal p{i}() {{ f{i} = 1; }}\n" for i in range(n))),
    "classes": lambda n: _members("")
    + "".join(f"class C{i} {{ public C{(i + 1) % n} f; public C{i}() {{ }} }}\n" for i in range(n)),
    "comments": lambda n: _members("") + "// nothing\n" * n,
}  # fmt: skip


@pytest.mark.few(2)
@pytest.mark.parametrize("shape", SHAPES)
def test_compile_time_is_linear(shape, steps):
    few, many = (steps(lambda n=n: compile_text(SHAPES[shape](n))) for n in (30, 300))
    assert many < 11 * few


@pytest.fixture
def collections():
    """The list of the generations of all garbage collections since the start of the test."""
    runs = []

    def note(phase, info):
        if phase == "start":
            runs.append(info["generation"])

    gc.callbacks.append(note)
    yield runs
    gc.callbacks.remove(note)


@pytest.mark.few(0)
def test_the_garbage_collector_is_off_during_compilation(tmp_path, collections):
    path = tmp_path / "mission.L"
    path.write_text(SHAPES["statements"](2000), encoding="utf-8")
    gc.collect()
    collections.clear()
    compile_file(path)
    assert len(collections) < 3
    assert gc.isenabled()


def test_the_garbage_collector_is_on_after_a_compile_error(tmp_path):
    path = tmp_path / "mission.L"
    path.write_text("resource Part { portal }", encoding="utf-8")
    with pytest.raises(ProgramError):
        compile_file(path)
    assert gc.isenabled()


def test_a_disabled_garbage_collector_stays_disabled(tmp_path):
    path = tmp_path / "mission.L"
    path.write_text(SHAPES["comments"](1), encoding="utf-8")
    gc.disable()
    try:
        compile_file(path)
        assert not gc.isenabled()
    finally:
        gc.enable()
