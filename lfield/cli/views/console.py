"""A console of rich without control sequences of its texts: only those of rich itself reach the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.segment import Segment

from lfield.text.terminal_escape import escape


class PlainConsole(Console):
    """A console for tables with texts of hosts and devices; rich leaves most control characters in them."""

    def render(self, *args: Any, **options: Any) -> Iterable[Segment]:
        """The segments of a drawing, with their texts made printable."""
        for segment in super().render(*args, **options):
            text = segment.text if segment.control else escape(segment.text)
            yield segment if text == segment.text else Segment(text, segment.style)
