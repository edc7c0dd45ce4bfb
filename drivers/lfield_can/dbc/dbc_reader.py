"""Parses the text of a DBC file into messages. Pure.

Invalid statements about messages and signals are errors. Valid but unusable parts (a signal beyond its frame,
value names of an unknown signal) are omitted with a warning.
"""

from __future__ import annotations

import re

from msgspec import Struct, field, structs

from lfield.driver import Diagnostics, Source, Span
from lfield_can.dbc import findings
from lfield_can.dbc.layout import FLOATS, LONGEST, LONGEST_CLASSIC, Message, Signal, representable
from lfield_can.dbc.statements import (
    ATTRIBUTE,
    KEYWORDS,
    MESSAGE,
    MESSAGE_FORM,
    MULTIPLEXED,
    NAMED_VALUES,
    NUMBER,
    RANGE,
    SIGNAL_FORM,
    SIGNAL_PARTS,
    VALTYPE,
    Statement,
    statements,
)

#: Bit 31 of an id: it has 29 bits. Masks of both kinds of ids.
EXTENDED, STANDARD_BITS, EXTENDED_BITS = 1 << 31, 0x7FF, 0x1FFFFFFF
#: The message where tools store signals without one.
NO_MESSAGE = "VECTOR__INDEPENDENT_SIG_MSG"
#: Values of the attribute VFrameFormat for frames of CAN FD.
_FD_FORMATS = frozenset({"14", "15", "StandardCAN_FD", "ExtendedCAN_FD"})
_J1939_FORMATS = frozenset({"3", "J1939PG"})
_MOST_BITS = 64
#: The null address of J1939: any sender.
ANY_SOURCE = 0xFE


class _Draft(Struct):
    """A message that is being read; `multiplexed` are the marks of its signals."""

    id: int
    name: str
    length: int
    span: Span
    signals: list[Signal] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    unusable: dict[str, str] = field(default_factory=dict)
    is_fd: bool = False
    is_j1939: bool = False
    is_switched: bool = False
    #: ms
    cycle: float = 0.0
    #: Names of over 32 characters, given in attributes; those of signals by their short names.
    long_name: str = ""
    long_names: dict[str, str] = field(default_factory=dict)

    def set(self, attribute: str, signal: str, value: str) -> None:
        """Sets an attribute of the message, or of one of its signals."""
        if attribute == "VFrameFormat":
            self.is_fd, self.is_j1939 = value in _FD_FORMATS, value in _J1939_FORMATS
        elif attribute == "CANFD_BRS":
            self.is_switched = value == "1"
        elif attribute == "GenMsgCycleTime" and re.fullmatch(NUMBER, value):
            self.cycle = float(value)
        elif attribute == "SystemMessageLongSymbol" and value:
            self.long_name = value
        elif attribute == "SystemSignalLongSymbol" and value:
            self.long_names[signal] = value

    def lengthen(self) -> None:
        """Applies the long names, after the last statement that uses short ones."""
        self.name = self.long_name or self.name
        for at, signal in enumerate(self.signals):
            selector = self.long_names.get(signal.multiplexer_signal or "", signal.multiplexer_signal)
            name = self.long_names.get(signal.name, signal.name)
            self.signals[at] = structs.replace(signal, name=name, multiplexer_signal=selector)

    def drop(self, at: int, reason: str) -> None:
        """Omits a signal."""
        self.unusable.setdefault(self.signals[at].name, reason)
        del self.signals[at], self.spans[at]


def read_messages(source: Source, found: Diagnostics) -> list[Message]:
    """The messages of a file. Mistakes are added to `found`; with errors there are no messages."""
    reader = _Reader(source, found)
    for statement in statements(source, found):
        reader.add_statement(statement)
    if not reader.is_dbc:
        found.found.clear()
        found.add(findings.NOT_DBC.at(Span(source, 0, min(1, len(source.text)))))
        return []
    messages = reader.messages()
    if not messages and not found.errors:
        found.add(findings.NO_MESSAGES.at(Span(source, 0, min(1, len(source.text)))))
    return [] if found.errors else messages


class _Reader:
    """Collects messages from statements."""

    def __init__(self, source: Source, found: Diagnostics) -> None:
        self._source, self._found = source, found
        self._drafts: dict[int, _Draft] = {}
        self._current: _Draft | None = None
        self._is_ignored = False
        self._known = self._unknown = 0

    @property
    def is_dbc(self) -> bool:
        """Whether most of the file consists of DBC statements; another kind of text may contain a few."""
        return self._known > self._unknown

    def add_statement(self, statement: Statement) -> None:
        """Handles a statement; those that do not affect bits are ignored."""
        is_known = statement.keyword in KEYWORDS
        self._known, self._unknown = self._known + is_known, self._unknown + (not is_known)
        if statement.keyword == "SG_":
            self._signal(statement)
            return
        self._current, self._is_ignored = None, False
        if statement.keyword == "BO_":
            self._message(statement)
        elif statement.keyword == "SIG_VALTYPE_":
            self._value_type(statement)
        elif statement.keyword == "SG_MUL_VAL_":
            self._selection(statement)
        elif statement.keyword == "VAL_":
            self._named_values(statement)
        elif statement.keyword == "BA_":
            self._attribute(statement)

    def _attribute(self, statement: Statement) -> None:
        match = ATTRIBUTE.match(statement.body)
        if match and (draft := self._drafts.get(int(match["id"]))):
            draft.set(match["name"], (match["signal"] or "").strip(), match["value"].strip())

    def messages(self) -> list[Message]:
        """All messages, after the last statement."""
        messages: dict[str, tuple[Message, _Draft]] = {}
        ids: dict[tuple[int, bool], _Draft] = {}
        for draft in self._drafts.values():
            draft.lengthen()
            if (message := self._finish(draft)) is None:
                continue
            key = message.frame_id, message.is_extended_frame
            first = messages.get(message.name, (None, None))[1] or ids.get(key)
            if first is not None:
                self._report_duplicate("message", draft.name, draft.span, first.span)
                continue
            messages[message.name], ids[key] = (message, draft), draft
        return [message for message, _ in messages.values()]

    # -- messages -----------------------------------------------------------------------------------------

    def _message(self, statement: Statement) -> None:
        match = MESSAGE.match(statement.body)
        if match is None:
            self._report_syntax(statement, 0, "an id, a name, ':' and a length", MESSAGE_FORM)
            self._is_ignored = True
            return
        span = Span(self._source, statement.at + match.start("id"), statement.at + match.end())
        draft = _Draft(int(match["id"]), match["name"], int(match["length"]), span)
        self._is_ignored = draft.name == NO_MESSAGE
        if self._is_ignored:
            return
        if not draft.name:
            self._found.add(findings.NO_NAME.at(span, what=f"message {draft.id}"))
            self._is_ignored = True
            return
        self._current = draft
        if first := self._drafts.get(draft.id):
            self._report_duplicate("message", draft.name, span, first.span)
        else:
            self._drafts[draft.id] = draft

    def _finish(self, draft: _Draft) -> Message | None:
        """The message of a draft; None for an impossible one."""
        bits = draft.id & ~EXTENDED
        extended = draft.id != bits or bits > STANDARD_BITS
        if bits > EXTENDED_BITS:
            self._found.add(findings.NO_SUCH_ID.at(draft.span, message=draft.name, id=f"0x{draft.id:X}"))
            return None
        if draft.length > LONGEST:
            self._found.add(findings.TOO_LONG.at(draft.span, message=draft.name, length=draft.length))
            return None
        if extended and draft.id == bits:
            self._found.add(findings.NOT_EXTENDED.at(draft.span, message=draft.name, id=f"0x{draft.id:X}"))
        self._place(draft)
        signals = sorted(draft.signals, key=lambda signal: signal.first)
        is_fd = draft.is_fd or draft.length > LONGEST_CLASSIC
        is_j1939 = extended and draft.is_j1939 and bits & 0xFF == ANY_SOURCE
        return Message(
            draft.name,
            bits,
            draft.length,
            signals,
            extended,
            is_fd,
            is_fd and draft.is_switched,
            max(0.0, draft.cycle / 1000.0),
            is_j1939,
            draft.unusable,
        )

    def _place(self, draft: _Draft) -> None:
        """Omits signals that do not fit the frame."""
        self._select(draft)
        for at in reversed(range(len(draft.signals))):
            signal, span = draft.signals[at], draft.spans[at]
            if signal.end > 8 * draft.length:
                finding = findings.BEYOND_FRAME.at(
                    span,
                    signal=signal.name,
                    message=draft.name,
                    end=(signal.end + 7) // 8,
                    length=_bytes(draft.length),
                )
            elif signal.is_float and signal.length not in FLOATS:
                reason = f"a float cannot have {signal.length} bits"
                finding = findings.NO_BITS.at(span, signal=signal.name, reason=reason)
            else:
                draft.signals[at] = self._with_range(signal, span)
                continue
            self._found.add(finding)
            draft.drop(at, f"{finding.message} ({self._source.name}:{span.line})")
        self._drop_unselected(draft)

    def _with_range(self, signal: Signal, span: Span) -> Signal:
        """A signal with the range in the file, if it contains any value of its bits."""
        lowest, highest = representable(signal)
        low = lowest if signal.minimum is None else signal.minimum
        high = highest if signal.maximum is None else signal.maximum
        if low <= highest and high >= lowest:
            return signal
        self._found.add(findings.NO_VALUES.at(span, signal=signal.name, low=f"{low:g}", high=f"{high:g}"))
        return structs.replace(signal, minimum=None, maximum=None)

    def _drop_unselected(self, draft: _Draft) -> None:
        """Omits signals whose multiplexer is missing."""
        while True:
            names = {signal.name for signal in draft.signals if signal.is_multiplexer}
            unselected = [
                at
                for at, signal in enumerate(draft.signals)
                if signal.multiplexer_signal is not None and signal.multiplexer_signal not in names
            ]
            if not unselected:
                return
            signal, span = draft.signals[unselected[-1]], draft.spans[unselected[-1]]
            finding = findings.NO_MULTIPLEXER.at(
                span, signal=signal.name, message=draft.name, name=signal.multiplexer_signal
            )
            self._found.add(finding)
            draft.drop(unselected[-1], f"{finding.message} ({self._source.name}:{span.line})")

    def _select(self, draft: _Draft) -> None:
        """Simple multiplexing: the one multiplexer selects all marked signals."""
        multiplexers = [s.name for s in draft.signals if s.is_multiplexer and not s.multiplexer_ids]
        name = multiplexers[0] if multiplexers else "that selects it"
        draft.signals = [
            structs.replace(signal, multiplexer_signal=name)
            if signal.multiplexer_ids and signal.multiplexer_signal is None
            else signal
            for signal in draft.signals
        ]

    # -- signals ------------------------------------------------------------------------------------------

    def _signal(self, statement: Statement) -> None:
        if self._is_ignored:
            return
        parts: dict[str, str] = {}
        at = 0
        for pattern, expected in SIGNAL_PARTS:
            match = pattern.match(statement.body, at)
            if match is None:
                self._report_syntax(statement, at, expected, SIGNAL_FORM)
                return
            parts.update({name: text for name, text in match.groupdict().items() if text is not None})
            at = match.end()
        name_at = statement.at + len(statement.body) - len(statement.body.lstrip())
        span = Span(self._source, name_at, name_at + max(1, len(parts["name"])))
        if self._current is None:
            self._found.add(findings.STRAY_SIGNAL.at(span, signal=parts["name"]))
        elif not parts["name"]:
            self._found.add(findings.NO_NAME.at(span, what=f"a signal of {self._current.name}"))
        else:
            self._add(self._current, self._parsed_signal(parts, span), span)

    def _parsed_signal(self, parts: dict[str, str], span: Span) -> Signal:
        name, mark = parts["name"], parts.get("mux", "")
        scale = float(parts["scale"])
        if not scale:
            self._found.add(findings.NO_SCALE.at(span, signal=name))
        low, high = (_end(parts.get(end, "")) for end in ("low", "high"))
        if low is not None and high is not None and low >= high:
            if low > high:
                self._found.add(findings.NO_RANGE.at(span, signal=name, low=parts["low"], high=parts["high"]))
            low = high = None
        if mark == "m":
            self._found.add(findings.SMALL_MARK.at(span, signal=name))
        digits = mark.strip("mM")
        selector = int(digits) if digits else None
        return Signal(
            name=name,
            start=int(parts["start"]),
            length=int(parts["length"]),
            is_motorola=parts["order"] == "0",
            is_signed=parts["sign"] == "-",
            scale=scale or 1.0,
            offset=float(parts["offset"]),
            minimum=low,
            maximum=high,
            unit=parts["unit"],
            is_multiplexer=mark.endswith("M") or mark == "m",
            multiplexer_ids=() if selector is None else (range(selector, selector + 1),),
        )

    def _add(self, draft: _Draft, signal: Signal, span: Span) -> None:
        if not 1 <= signal.length <= _MOST_BITS:
            reason = f"it has {signal.length} bits"
            self._found.add(findings.NO_BITS.at(span, signal=signal.name, reason=reason))
            draft.unusable[signal.name] = f"signal {signal.name} has {signal.length} bits"
            return
        for other, position in zip(draft.signals, draft.spans, strict=True):
            # In different pages of a multiplexed message one name may have several positions.
            if other.name == signal.name and not (other.multiplexer_ids and signal.multiplexer_ids):
                self._report_duplicate("signal", signal.name, span, position)
                return
        draft.signals.append(signal)
        draft.spans.append(span)

    # -- later statements about signals -------------------------------------------------------------------

    def _value_type(self, statement: Statement) -> None:
        match = VALTYPE.match(statement.body)
        if match is None:
            self._report_syntax(
                statement, 0, "an id, a signal, ':' and 0 to 3", "write SIG_VALTYPE_ 256 gain : 1;"
            )
        elif match[3] in "12":
            self._change(statement, match[1], match[2], is_float=True)

    def _selection(self, statement: Statement) -> None:
        match = MULTIPLEXED.match(statement.body)
        if match is None:
            form = "write SG_MUL_VAL_ 256 limit page 1-3, 7-7;"
            self._report_syntax(statement, 0, "an id, a signal, its multiplexer and ranges", form)
            return
        ids = [range(int(low), int(high) + 1) for low, high in RANGE.findall(match[4])]
        self._change(statement, match[1], match[2], multiplexer_signal=match[3], multiplexer_ids=tuple(ids))

    def _named_values(self, statement: Statement) -> None:
        if match := NAMED_VALUES.match(statement.body):
            self._change(statement, match[1], match[2])

    def _change(self, statement: Statement, id: str, name: str, **values: object) -> None:
        """Changes a signal, or reports that it is missing."""
        draft = self._drafts.get(int(id))
        if draft is None and int(id) & EXTENDED_BITS == 0:
            return  # signals in no message
        positions = [at for at, signal in enumerate(draft.signals) if signal.name == name] if draft else []
        for at in positions:
            assert draft is not None
            draft.signals[at] = structs.replace(draft.signals[at], **values)
        if not positions and not (draft and name in draft.unusable):
            subject = f"signal {name} of {draft.name}" if draft else f"a message with the id {id}"
            span = Span(self._source, statement.at - len(statement.keyword), statement.at)
            self._found.add(findings.MISSING.at(span, statement=statement.keyword, what=subject))

    # -- findings -----------------------------------------------------------------------------------------

    def _report_syntax(self, statement: Statement, at: int, expected: str, form: str) -> None:
        """Reports a syntax error in a statement; `at` is the number of valid characters."""
        rest = statement.body[at:]
        at += len(rest) - len(rest.lstrip())
        following = statement.body[at:].split(None, 1)[:1]
        start = statement.at + at
        actual = f"'{following[0]}'" if following else "the end of the line"
        span = Span(self._source, start, start + max(1, len(following[0]) if following else 1))
        self._found.add(findings.SYNTAX.at(span, what=expected, found=actual, form=form))

    def _report_duplicate(self, kind: str, name: str, span: Span, first: Span) -> None:
        self._found.add(findings.DUPLICATE.at(span, what=kind, name=name, line=first.line))


def _end(text: str) -> float | None:
    """An end of a range; None if the file has none."""
    return float(text) if re.fullmatch(NUMBER, text) else None


def _bytes(count: int) -> str:
    return f"{count} byte{'s' * (count != 1)}"
