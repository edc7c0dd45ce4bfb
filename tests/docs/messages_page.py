"""The page of all errors, diagnostics and log lines by code: `python tests/docs/messages_page.py --write`.

The sources are the classes of `lfield/errors.py` and the tables of the diagnostics and of the log.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import lfield_can.log_messages
import lfield_dynamixel.log_messages
import lfield_mavlink.log_messages
from lfield.capability.registry_reader import messages as registry_messages
from lfield.errors import LfieldError, SystemRefusal
from lfield.geodata.findings import FILE_FINDINGS
from lfield.lang import messages as program_messages
from lfield.operator.diagnostics import DIAGNOSES
from lfield.service.messages import SERVICE_MESSAGES
from lfield.text.log_messages import DEVICE_MESSAGES, LOG_MESSAGES, LogMessage
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import FINDING_CODES
from lfield.text.suggestions import listed
from lfield.text.yaml_source import YAML_CODES

PAGE = Path(__file__).resolve().parents[2] / "lfield" / "docs" / "messages.md"

_HEAD = """\
# Errors, log lines and diagnostics by code

Every error, log line and diagnostic has a code that does not change between versions; the wording may.
`--json` carries it: `check` and `doctor` in the `code` of each finding, `ps` and `query` for each host that
did not answer, `up` and `logs` in each line, `events` in the `code` and `level` of each event `logged`, and
every command that fails prints `{"error": ..., "code": ..., "exit_status": ...}`.
[Exit statuses](exit-statuses.md) are on a page of their own. This page is generated:
`python tests/docs/messages_page.py --write`.
"""


def page() -> str:
    """The whole page: errors, log lines, then the diagnostics of programs and of files."""
    return "\n".join(
        (
            _HEAD,
            "## Errors of commands\n",
            _table(("code", "exit status", "meaning", "what to do"), _errors()),
            "## Log lines\n",
            _table(("code", "level", "line", "meaning"), _log_lines(LOG_MESSAGES.values())),
            "## Log lines of the service of a robot\n",
            _table(("code", "level", "line", "meaning"), _log_lines(SERVICE_MESSAGES.values())),
            "## Log lines of devices\n",
            "Each line begins with the name of the device: `lead.fc crashed: ...`. A driver without codes\n"
            "of its own logs under `device-report`, with a colon after the name.\n",
            _table(("code", "level", "line", "meaning"), _log_lines(device_messages())),
            "## Findings of `lfield doctor`\n",
            _table(("code", "about"), ((f"`{code}`", about) for code, about in DIAGNOSES.items())),
            "## Diagnostics of programs and deployments\n",
            _table(("code", "message", "hint"), _findings(program_messages.TABLE.values())),
            "## Diagnostics of the registry of capabilities\n",
            _table(("code", "message", "hint"), _findings(registry_messages.TABLE.values())),
            "## Diagnostics of YAML files\n",
            _table(("code", "meaning"), YAML_CODES.items()),
            "## Findings of `lfield plan check`\n",
            "Codes from M901 on are warnings.\n",
            _table(("code", "meaning"), ((f"`{code}`", text) for code, text in FILE_FINDINGS.items())),
            "## Findings without a position in a file\n",
            _table(("code", "meaning"), FINDING_CODES.items()),
        )
    )


def error_classes(root: type[LfieldError] = LfieldError) -> Iterator[type[LfieldError]]:
    """The classes of `lfield/errors.py`, each before its subclasses."""
    yield root
    for each in root.__subclasses__():
        if each.__module__ == LfieldError.__module__:
            yield from error_classes(each)


def _errors() -> Iterator[tuple[str, ...]]:
    for each in error_classes():
        # The rest of the docstring is about the attributes.
        meaning = re.split(r"; |: `|\n", each.__doc__ or "")[0].rstrip(".")
        status = "" if each is SystemRefusal else str(each.exit_status)
        yield f"`{each.code}`", status, meaning, each.remedy


def driver_messages() -> dict[str, dict[str, LogMessage]]:
    """The log messages of each driver, by the names of their constants."""
    modules = (lfield_mavlink.log_messages, lfield_can.log_messages, lfield_dynamixel.log_messages)
    return {
        module.__name__: {name: each for name, each in vars(module).items() if isinstance(each, LogMessage)}
        for module in modules
    }


def device_messages() -> Iterator[LogMessage]:
    """The log messages of guards, of the base class of drivers, and of each driver."""
    yield from DEVICE_MESSAGES.values()
    for messages in driver_messages().values():
        yield from messages.values()


def _log_lines(messages: Iterable[LogMessage]) -> Iterator[tuple[str, ...]]:
    for each in messages:
        yield f"`{each.code}`", each.level, _plain(each.template), "; ".join(_meaning(each))


def _meaning(message: LogMessage) -> Iterator[str]:
    """The meaning, and the JSON fields of the parts of the line that are not fields."""
    if message.meaning:
        yield message.meaning
    for name, clause in message.clauses.items():
        yield f"{{{name}}} depends on {listed(clause.values)}"


def _findings(kinds: Iterable[FindingKind]) -> Iterator[tuple[str, ...]]:
    for each in kinds:
        warning = " (warning)" if each.severity == "warning" else ""
        yield f"`{each.code}`", _plain(each.sentence) + warning, _plain(each.hint)


def _plain(template: str) -> str:
    """A template as text, with single braces instead of doubled ones."""
    return template.replace("{{", "{").replace("}}", "}")


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(_cell(cell) for cell in row)} |\n" for row in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "\\<")


if __name__ == "__main__":
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
