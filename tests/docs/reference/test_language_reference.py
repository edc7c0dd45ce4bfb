"""The language reference has the library, the reserved words and the exceptions of the front end."""

import re

from language_reference import PAGE, updated

from lfield.lang.checker.symbols import EXCEPTION_NAMES
from lfield.lang.scanner import KEYWORDS

DOCUMENT = PAGE.read_text(encoding="utf-8")


def test_generated_library_table_is_current() -> None:
    assert updated(DOCUMENT) == DOCUMENT, "run: python tests/docs/reference/language_reference.py --write"


def test_every_reserved_word_is_listed() -> None:
    (words,) = re.findall(r"Reserved words:\n\n(.*?)\n\n", DOCUMENT, re.DOTALL)
    assert set(re.findall(r"\w+", words)) == KEYWORDS


def test_every_built_in_exception_is_listed() -> None:
    assert [name for name in EXCEPTION_NAMES if f"`{name}`" not in DOCUMENT] == []
