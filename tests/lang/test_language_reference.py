"""The language reference says what the front end does."""

import re
from pathlib import Path

from lang_expectations import ROVER

from lfield.capability.reading.reader import read_registry
from lfield.capability.types.language import RegistryTypes
from lfield.driver.plugins import Plugins
from lfield.lang.checker.symbols import EXCEPTION_NAMES
from lfield.lang.deployment import parse_deployment
from lfield.lang.frontend import check_text
from lfield.lang.reference import updated
from lfield.lang.scanner import KEYWORDS
from lfield.lang.tree import UnitKind

PLUGINS = Plugins()
for _driver in ("mavlink", "can", "dynamixel"):
    PLUGINS.add(f"lfield_{_driver}:PLUGIN")
DOCUMENT = (Path(__file__).parents[2] / "lfield" / "docs" / "language.md").read_text(encoding="utf-8")


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", DOCUMENT, re.DOTALL | re.MULTILINE)


def test_generated_tables_are_current() -> None:
    assert updated(DOCUMENT) == DOCUMENT, "run: python -m lfield.lang.reference lfield/docs/language.md"


def test_every_reserved_word_is_listed() -> None:
    (words,) = re.findall(r"Reserved words:\n\n(.*?)\n\n", DOCUMENT, re.DOTALL)
    assert set(re.findall(r"\w+", words)) == KEYWORDS


def test_every_built_in_exception_is_listed() -> None:
    assert [name for name in EXCEPTION_NAMES if f"`{name}`" not in DOCUMENT] == []


def test_every_example_program_checks() -> None:
    examples = blocks("java")
    assert len(examples) >= 4
    for text in examples:
        found = check_text(
            text,
            devices={"Rover": ROVER, **PLUGINS.device_types},
            find_include=PLUGINS.find_source,
            capabilities=RegistryTypes(read_registry),
        ).diagnostics
        assert [d.render() for d in found] == []


def test_every_example_deployment_is_good() -> None:
    units: dict[str, UnitKind] = {"Arm": "resource", "Survey": "coordinator"}
    examples = blocks("text dL")
    assert examples
    for text in examples:
        assert parse_deployment(text, "mission.dL", units)[1] == []
