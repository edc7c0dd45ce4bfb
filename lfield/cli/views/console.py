"""A console of rich whose texts order no terminal anything: the control sequences are those of rich alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.segment import Segment

from lfield.text.terminal_escape import escape


class PlainConsole(Console):
    """Texts of hosts and devices stand in its tables; rich leaves most control characters in them."""

    def render(self, *args: Any, **options: Any) -> Iterable[Segment]:
        """The segments of what is drawn, their texts as they are shown."""
        for segment in super().render(*args, **options):
            text = segment.text if segment.control else escape(segment.text)
            yield segment if text == segment.text else Segment(text, segment.style)
