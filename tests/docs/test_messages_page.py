"""Every error and log line has a unique code, and the page of all codes is current."""

from __future__ import annotations

import ast
import re
import string
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from messages_page import PAGE, device_messages, driver_messages, error_classes, page

import lfield
from lfield.text import log_messages
from lfield.text.yaml_source import YAML_CODES


def test_message_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/docs/messages_page.py --write"


def test_every_error_class_has_its_own_code_and_remedy() -> None:
    classes = list(error_classes())
    assert len(classes) > 30
    assert [each.__name__ for each in classes if not {"code", "remedy"} <= vars(each).keys()] == []
    assert [code for code, count in Counter(each.code for each in classes).items() if count > 1] == []
    assert [each.code for each in classes if not re.fullmatch(r"[a-z]+(-[a-z]+)*", each.code)] == []


def test_every_code_of_a_yaml_finding_is_listed() -> None:
    sources = (file.read_text(encoding="utf-8") for file in Path(lfield.__file__).parent.rglob("*.py"))
    used = {code for source in sources for code in re.findall(r'"(Y1\d\d)"(?!:)', source)}
    assert used == YAML_CODES.keys()


#: Codes of lines whose whole text comes from a program, a driver or Python.
FREE_TEXT = {"program-output", "device-report", "traceback"}
#: The folders with code that writes log lines.
SOURCES = [Path(lfield.__file__).parent, *(Path(lfield.__file__).parents[1] / "drivers").glob("lfield_*")]
DRIVERS = driver_messages()


def trees() -> Iterator[tuple[Path, ast.Module]]:
    """The parsed files of the product that write log lines."""
    for folder in SOURCES:
        for file in folder.rglob("*.py"):
            source = file.read_text(encoding="utf-8")
            if re.search(r"log_messages|\b_?note\(|WriteLog", source):
                yield file, ast.parse(source)


def table_of(file: Path) -> Mapping[str, object]:
    """The log messages for a file: the table of its driver, or the table of lfield."""
    return next(
        (table for name, table in DRIVERS.items() if name.split(".")[0] in file.parts), vars(log_messages)
    )


def log_calls() -> Iterator[tuple[Mapping[str, object], str, list[ast.keyword]]]:
    """The table, the name and the values of each message that the product logs."""
    for file, tree in trees():
        aliases = set()
        for node in ast.walk(tree):
            match node:
                case ast.Call(
                    ast.Attribute(ast.Attribute(ast.Name("log_messages"), name), "line"), _, values
                ):
                    yield table_of(file), name, values
                    aliases.add(name)
        for node in ast.walk(tree):
            match node:
                case ast.Attribute(ast.Name("log_messages"), name) if name.isupper() and name not in aliases:
                    # The code chooses between two messages with the same fields: `(A if x else B).line(...)`.
                    yield table_of(file), name, []


def fields_of(message: log_messages.LogMessage) -> set[str]:
    """The values that a line needs: the fields of its template and of its clauses."""
    named = {field for _, field, _, _ in string.Formatter().parse(message.template) if field}
    assert message.clauses.keys() <= named
    return (named - message.clauses.keys()).union(*(each.values for each in message.clauses.values()))


def test_every_log_call_has_the_values_of_its_template() -> None:
    used = {"device-report"}  # `report_line` uses this code
    for table, name, values in log_calls():
        message = table[name]
        assert isinstance(message, log_messages.LogMessage)
        used.add(message.code)
        if values:
            assert (name, {str(each.arg) for each in values}) == (name, fields_of(message))
    assert used == {each.code for each in (*log_messages.LOG_MESSAGES.values(), *device_messages())}


def test_log_codes_are_unique_and_well_formed() -> None:
    codes = [each.code for each in (*log_messages.LOG_MESSAGES.values(), *device_messages())]
    assert [code for code, count in Counter(codes).items() if count > 1] == []
    assert [code for code in codes if not re.fullmatch(r"[a-z]+(-[a-z]+)*", code)] == []


def test_log_template_contains_words() -> None:
    """The text of a template with only a field would not be in the table."""
    bare = [
        each.code
        for each in (*log_messages.LOG_MESSAGES.values(), *device_messages())
        if not re.search(r"[A-Za-z]{2}", re.sub(r"\{[^}]*\}", "", each.template))
    ]
    assert set(bare) <= FREE_TEXT


def test_no_log_call_passes_a_literal_sentence() -> None:
    """No argument of a log function and no value of a template is a literal sentence."""
    free = []
    for file, tree in trees():
        for node in ast.walk(tree):
            match node:
                case ast.Call(ast.Attribute(_, "note" | "_note" | "log_once"), arguments, _) | ast.Call(
                    ast.Name("note" | "WriteLog" | "WriteLogOnce"), arguments, _
                ) if any(is_sentence(each) for each in arguments[-1:]):
                    free.append(f"{file.name}:{node.lineno}")
                case ast.Call(ast.Attribute(_, "line"), _, values) if any(
                    is_sentence(each.value, words=4) for each in values
                ):
                    free.append(f"{file.name}:{node.lineno}")
    assert free == []


def is_sentence(node: ast.expr, words: int = 1) -> bool:
    """Whether an expression is a literal with at least `words` words, or a choice that contains one."""
    match node:
        case ast.Constant(str(text)):
            return len(text.split()) >= words
        case ast.JoinedStr(parts):
            text = "".join(part.value for part in parts if isinstance(part, ast.Constant))
            return len(text.split()) >= words
        case ast.IfExp(_, body, orelse):
            return is_sentence(body, words) or is_sentence(orelse, words)
    return False


def test_literal_sentence_in_a_log_call_is_found() -> None:
    (statement,) = ast.parse("note(f'lost {host}' if lost else '')").body
    assert isinstance(statement, ast.Expr)
    assert isinstance(statement.value, ast.Call)
    assert is_sentence(statement.value.args[0])


def test_driver_report_keeps_its_code_and_level() -> None:
    text = log_messages.WATCHDOG_WAIVED.line(own="none", longest=1.0)
    line = log_messages.report_line("lead.fc", *log_messages.report_fields(text))
    assert (line.code, line.level) == ("watchdog-waived", "info")
    plain = log_messages.report_line("lead.fc", *log_messages.report_fields("warming up"))
    assert (plain, plain.code) == ("lead.fc: warming up", "device-report")
