"""The programs of the documentation of `lfield.client`, and the configuration for assistants."""

from __future__ import annotations

import json
import re
from pathlib import Path

PAGES = Path(__file__).parents[3] / "lfield" / "docs"


def program_of_page(name: str) -> str:
    """The program with that file name."""
    page = (PAGES / "client.md").read_text()
    (found,) = re.findall(rf"```python {re.escape(name)}\n(.*?)```", page, re.DOTALL)
    return found


def assistant_command() -> tuple[str, list[str]]:
    """The command with which the client of an assistant starts the server, and its arguments."""
    (found,) = re.findall(r"```json\n(.*?)```", (PAGES / "assistants.md").read_text(), re.DOTALL)
    server = json.loads(found)["mcpServers"]["lfield"]
    return server["command"], server["args"]
