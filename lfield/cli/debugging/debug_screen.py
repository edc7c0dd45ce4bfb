"""The windows of the debugger in a terminal: source, stack, variables, timeline, output, and a command line.

Keys: F10 next, F11 step, F12 out, F5 continue; with Shift backward.
"""

from __future__ import annotations

from collections.abc import Callable

from prompt_toolkit.application import Application
from prompt_toolkit.buffer import Buffer
from prompt_toolkit.formatted_text import StyleAndTextTuples
from prompt_toolkit.history import InMemoryHistory
from prompt_toolkit.key_binding import KeyBindings, KeyPressEvent
from prompt_toolkit.layout import (
    BufferControl,
    Dimension,
    FormattedTextControl,
    HSplit,
    Layout,
    VSplit,
    Window,
)
from prompt_toolkit.layout.processors import BeforeInput
from prompt_toolkit.output import Output

from lfield.cli.debugging import text_views
from lfield.cli.debugging.command_line import DebuggerCommands
from lfield.cli.debugging.search_watch import interruptible
from lfield.errors import LfieldError
from lfield.replay.debugger.host_timeline import SearchCancelled

#: Keys of moves, with their commands.
KEYS = {
    "f10": "next",
    "f11": "step",
    "f12": "out",
    "f5": "continue",
    "f22": "back next",
    "f23": "back step",
    "f24": "back out",
    "f17": "back continue",
}
#: Lines of output that are kept, and those that are visible.
KEPT_LINES, OUTPUT_LINES = 500, 8
#: Lines of source that are formatted before and after the position: more than a screen has.
SOURCE_LINES = 60


class DebugScreen:
    """Shows a debugger in windows and executes typed commands, until `quit`."""

    def __init__(self, commands: DebuggerCommands, output: Output | None = None) -> None:
        self._commands = commands
        self._output = ["help lists the commands"]
        self._input = Buffer(history=InMemoryHistory(), multiline=False, accept_handler=self._accept)
        self._texts: dict[str, list[str]] = {}
        self.application: Application[None] = Application(
            Layout(self._windows()), key_bindings=self._keys(), full_screen=True, output=output
        )
        self._refresh()

    def run(self) -> None:
        """Run until the user quits."""
        self.application.run()

    def execute(self, text: str) -> None:
        """Execute a command and show its output."""
        try:
            with self.application.input.cooked_mode(), interruptible(self._commands.debugger.team):
                lines = self._commands.execute(text)
        except LfieldError as error:
            lines = [str(error)]
        except (SearchCancelled, KeyboardInterrupt):
            # The position is unchanged until a match is found.
            lines = ["interrupted"]
        self._output = [*self._output, f"> {text}", *lines][-KEPT_LINES:]
        self._refresh()
        if self._commands.is_done:
            self.application.exit()

    def lines(self, window: str) -> list[str]:
        """The lines of a window: 'source', 'stack', 'variables', 'threads', 'output' or 'timeline'."""
        return self._texts[window]

    def _accept(self, buffer: Buffer) -> bool:
        if buffer.text.strip():
            self.execute(buffer.text)
        return False

    def _refresh(self) -> None:
        debugger, frame = self._commands.debugger, self._commands.frame
        line = None if frame is None else frame.line
        self._texts = {
            "position": [text_views.position_line(debugger)],
            "source": text_views.source_lines(debugger, line, SOURCE_LINES, SOURCE_LINES),
            "stack": text_views.stack_lines(debugger.stack(), self._commands.frame_number),
            "variables": [] if frame is None else text_views.variable_lines(debugger, frame),
            "threads": text_views.thread_lines(debugger),
            "output": self._output[-OUTPUT_LINES:],
        }

    # --- windows --------------------------------------------------------------------------------------

    def _windows(self) -> HSplit:
        right = HSplit(
            [
                *self._titled("stack", Dimension(weight=1)),
                *self._titled("variables", Dimension(weight=2)),
                *self._titled("threads", Dimension(weight=1)),
            ],
            width=Dimension(weight=2),
        )
        left = HSplit([Window(self._source_control(), always_hide_cursor=True)], width=Dimension(weight=3))
        return HSplit(
            [
                Window(self._control("position"), height=1, style="reverse"),
                VSplit([left, Window(width=1, char="|"), right]),
                Window(FormattedTextControl(self._timeline), height=1),
                Window(self._control("output"), height=OUTPUT_LINES),
                Window(BufferControl(self._input, input_processors=[BeforeInput("(lfield) ")]), height=1),
            ]
        )

    def _titled(self, name: str, height: Dimension) -> list[Window]:
        title = Window(FormattedTextControl(f"-- {name} "), height=1, char="-")
        return [title, Window(self._control(name), height=height, wrap_lines=False)]

    def _control(self, name: str) -> FormattedTextControl:
        return FormattedTextControl(lambda: "\n".join(self._texts.get(name, [])))

    def _source_control(self) -> FormattedTextControl:
        def styled_lines() -> StyleAndTextTuples:
            parts: StyleAndTextTuples = []
            for text in self._texts.get("source", []):
                if text.startswith(">"):
                    # The window scrolls to its cursor.
                    parts.append(("[SetCursorPosition]", ""))
                parts.append(("reverse" if text.startswith(">") else "", f"{text}\n"))
            return parts

        return FormattedTextControl(styled_lines)

    def _timeline(self) -> str:
        return text_views.timeline_line(self._commands.debugger, self.application.output.get_size().columns)

    def _keys(self) -> KeyBindings:
        found = KeyBindings()
        for key, command in KEYS.items():
            found.add(key)(self._key_handler(command))

        @found.add("c-c")
        @found.add("c-d")
        def _(event: KeyPressEvent) -> None:
            event.app.exit()

        return found

    def _key_handler(self, command: str) -> Callable[[KeyPressEvent], None]:
        return lambda event: self.execute(command)
