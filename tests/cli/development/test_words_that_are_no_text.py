"""Every word of a command may contain bytes that are not UTF-8, without an internal error or unreadable text.
Sources are a terminal in Latin-1, a script, an old disk. Python represents each byte as half of a surrogate
pair, which has no encoding.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

from lfield import exit_status
from lfield.cli.main import COMMANDS, MODULES, main

# : Undecodable words, alone and where a command parses the word.
WORDS = ("\udcff", "\udcff=1", "a=\udcff", "localhost=\udcff:1", "udp:\udcff:1", "Lift where a == \udcff")
MISSION = ["--deploy", "mission.dL"]
# : Further words of a command, so that it parses its words and then ends: nothing is started or opened.
BESIDE = {
    "build": ["-o", "out.lfm"],
    "up": ["--deploy", "mission.lfm", "--host", "nobody"],
    "query": [*MISSION, "--files"],
    "watch": [*MISSION, "--tiles", "none.mbtiles"],
    "events": [*MISSION, "--no-follow"],
    "kit": ["--endpoint", "nowhere"],
    "keys person": ["--may", "everything"],
    **dict.fromkeys(("ps", "logs", "estop", "pause", "resume"), MISSION),
    **dict.fromkeys(("forget", "recover", "doctor", "setup"), MISSION),
    "sim can": ["--listen", "nowhere"],
    "sim mavlink": ["--listen", "nowhere"],
    "sim dynamixel": ["--servo", "none"],
}
# : The values of required words, while others are tested.
GOOD = {"driver": "mavlink", "query": "Lift", "files": "mission.L", "file": "mission.dL"}
# : pytest parses the words of `test`.
LEFT_OUT = {"test"}


class Leaf(NamedTuple):
    """A command or subcommand with its parser."""

    name: str
    parser: argparse.ArgumentParser


def said(words: list[str]) -> tuple[int, str]:
    """The status of a command in this process, and its messages on an ASCII terminal."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="ascii") for _ in range(2))
    with redirect_stdout(out), redirect_stderr(err):
        status = main(words)
    err.seek(0)
    return status, err.read()


def leaves(name: str, parser: argparse.ArgumentParser) -> Iterator[Leaf]:
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in below:
        for word, each in action.choices.items():
            yield from leaves(f"{name} {word}", each)
    if not below and name not in LEFT_OUT:
        yield Leaf(name, parser)


def all_leaves() -> Iterator[Leaf]:
    for name in COMMANDS:
        parser = argparse.ArgumentParser()
        import_module(MODULES[name]).add_arguments(parser)
        yield from leaves(name, parser)


def cases() -> Iterator[tuple[str, str]]:
    """A leaf, and an option with a word as its value."""
    for leaf in all_leaves():
        for action in leaf.parser._actions:
            if action.nargs != 0:
                yield leaf.name, (action.option_strings or [action.dest])[-1]


def lines(name: str, tried: str) -> Iterator[list[str]]:
    """Command lines with an undecodable word in one place."""
    (parser,) = (leaf.parser for leaf in all_leaves() if leaf.name == name)
    positional = [action for action in parser._actions if not action.option_strings]
    names_a_file = next(a.type is Path for a in parser._actions if tried in (a.dest, *a.option_strings))
    for word in WORDS[:1] if names_a_file else WORDS:
        words = name.split()
        for action in positional:
            if action.dest == tried:
                words.append(word)
            elif action.nargs in (None, "+", 1):
                words.append(GOOD.get(action.dest, (action.choices or ["some"])[0]))
        other_options = BESIDE.get(name, [])
        option = tried if tried.startswith("-") else "--deploy"
        if option in other_options and (option == tried or tried == "mission"):
            at = other_options.index(option)
            other_options = other_options[:at] + other_options[at + 2 :]
        yield words + other_options + ([tried, word] if tried.startswith("-") else [])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with an undecodable name and a mission; commands find nothing else on this computer."""
    path = tmp_path_factory.mktemp("words") / "n\udcf6rd"
    path.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        patch.setenv("LFIELD_TRACEBACK", "1")
        for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "TMPDIR"):
            patch.setenv(name, str(path.parent / "\udcff"))
        patch.setenv("LFIELD_RUNS", "here")
        (path / "mission.L").write_text("coordinator Boss { init(string[] arg) { } }\n", encoding="utf-8")
        (path / "mission.dL").write_text("//Boss:boss@localhost:1\n", encoding="utf-8")
        assert main(["build", "mission.dL", "-o", "mission.lfm"]) == exit_status.DONE
        yield path


@pytest.mark.few(4)
@pytest.mark.parametrize(("name", "option"), list(cases()))
def test_an_undecodable_word_causes_no_internal_error(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, option: str
) -> None:
    # `lfield mcp` reads its input to the end.
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO()))
    for words in lines(name, option):
        status, output = said(words)
        assert status in exit_status.MEANINGS, (words, output)
        assert status != exit_status.SOFTWARE, (words, output)
        assert r"\udcff" not in output, words


@pytest.mark.parametrize("file", ["mission", "m\udcf6"])
def test_a_file_may_have_an_undecodable_name(folder: Path, file: str) -> None:
    for suffix in ("L", "dL"):
        (folder / f"{file}.{suffix}").write_bytes((folder / f"mission.{suffix}").read_bytes())
    for words in (
        ["check", f"{file}.L", f"{file}.dL"],
        ["check", "--json", f"{file}.dL"],
        ["build", f"{file}.L", "-o", f"{file}.lb"],
        ["build", f"{file}.dL", "-o", f"{file}.lfm", "--inputs", f"{file}.inputs"],
        ["disasm", f"{file}.lb"],
        ["inspect", f"{file}.lfm"],
    ):
        assert said(words)[0] == exit_status.DONE


def test_characters_outside_the_output_encoding_are_escaped(folder: Path) -> None:
    """With `LC_ALL=C PYTHONUTF8=0` a unit, a name, or the output of a program must not end a command."""
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    with redirect_stdout(out):
        assert main(["capabilities", "show", "Lift"]) == exit_status.DONE
    out.seek(0)
    assert r"temperature (\u{b0}C)" in out.read()
    status, output = said(["capabilities", "show", "größe"])
    assert (status, output.startswith(r"lfield: the registry has no 'gr\u{f6}\u{df}e'")) == (
        exit_status.USAGE,
        True,
    )
