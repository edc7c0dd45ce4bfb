"""Every option of every command: an invalid value is rejected with a one-sentence message without the name of
a Python function.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest

from lfield.cli.main import COMMANDS, MODULES
from lfield.errors import LfieldError
from lfield.text.number_arguments import real_above_0, real_between, whole_between

#: Invalid or useless numbers; Python parses no number of 5,000 digits.
JUNK = ("soon", "400d", "nan", "inf", "-1", "1e400", "0.0002", "²", "1,2", "0x", ":", "9" * 5000)


def options_of(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from options_of(below)
        elif action.type not in (None, str, Path):
            yield action


@pytest.mark.parametrize("name", COMMANDS)
def test_an_invalid_option_value_is_refused_with_a_sentence(name: str) -> None:
    parser = argparse.ArgumentParser()
    import_module(MODULES[name]).add_arguments(parser)
    for option in options_of(parser):
        for word in JUNK:
            # Any other exception would be reported with the name of the function.
            with suppress(argparse.ArgumentTypeError):
                option.type(word)


@pytest.mark.parametrize("name", ["up", "keys", "kit", "query", "sim"])
def test_commands_have_options_to_test(name: str) -> None:
    parser = argparse.ArgumentParser()
    import_module(MODULES[name]).add_arguments(parser)
    assert list(options_of(parser))


@pytest.mark.parametrize(
    ("reads", "good", "value", "bad", "sentence"),
    [
        (real_above_0(3.2e9), "31536000", 31536000.0, "0", "a number above 0 and at most 3200000000"),
        (real_between(0.1, 10.0), "0.1", 0.1, "10.1", "a number from 0.1 to 10"),
        (whole_between(1, 36500, "days"), "36500", 36500, "36501", "a whole number of days from 1 to 36500"),
    ],
)  # fmt: skip
def test_the_sentence_names_the_bounds(reads, good: str, value: float, bad: str, sentence: str) -> None:
    assert reads(good) == value
    with pytest.raises(argparse.ArgumentTypeError, match=f"must be {sentence}, not '{bad}'"):
        reads(bad)


def _remedies(base: type[LfieldError]) -> Iterator[str]:
    yield base.remedy
    for below in base.__subclasses__():
        yield from _remedies(below)


def test_the_commands_in_remedies_are_accepted() -> None:
    commands = {
        words for remedy in _remedies(LfieldError) for words in re.findall(r"`lfield ([^`]+ [^`]+)`", remedy)
    }
    assert len(commands) > 3
    for command in commands:
        name, *words = command.split()
        parser = argparse.ArgumentParser(exit_on_error=False)
        import_module(MODULES[name]).add_arguments(parser)
        assert parser.parse_known_args(words)[1] == [], command
