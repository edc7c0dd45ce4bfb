"""The programs of the page about `lfield.client`."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "lfield" / "docs" / "client.md"


def program_of_page(name: str) -> str:
    """The program with that file name."""
    (found,) = re.findall(rf"```python {re.escape(name)}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    return found
