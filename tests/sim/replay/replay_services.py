"""Differences in the exchange of parameters, missions, files and logs."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator

from replay_table import Difference, Figures
from replay_trace import Line, Trace

#: Seconds: a parameter is sent 0.001 to 0.03 after its request, or 0.1 late (0.09 to 0.13).
PARAMETER_TIME = 0.07
#: Seconds: upload requests are repeated each 0.25 to 0.27, or 1.00 to 1.01; items are reached within 10 %.
PLAN_TIME, REACH_TIME, REACH_SHARE = 0.2, 2.0, 0.1
#: Seconds to wait for the answer to an input.
PARAMETER_WINDOW, PLAN_WINDOW = 1.5, 10.0
PLANS = (
    "MISSION_COUNT",
    "MISSION_ITEM",
    "MISSION_ITEM_INT",
    "MISSION_REQUEST",
    "MISSION_REQUEST_INT",
    "MISSION_ACK",
)
ASKING = (*PLANS, "MISSION_REQUEST_LIST", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT")


def services(real: Trace, fake: Trace) -> Iterator[Difference]:
    """All differences of one recording, in no order."""
    yield from _parameters(real, fake)
    yield from _plans(real, fake)
    yield from _reached(real, fake)
    yield from _logs(real, fake)
    if real.scenario.startswith("j-"):
        yield from _files(real, fake)


# -- parameters ------------------------------------------------------------------------------------------


def _parameters(real: Trace, fake: Trace) -> Iterator[Difference]:
    requests = [line for line in real.inputs if line.type in ("PARAM_REQUEST_READ", "PARAM_SET")]
    late: Line | None = None
    for line in requests:
        same = (each.t for each in requests if each.t > line.t and _name(each) == _name(line))
        lists = (each.t for each in real.inputs if each.t > line.t and each.type == "PARAM_REQUEST_LIST")
        end = min(next(same, math.inf), next(lists, math.inf), line.t + PARAMETER_WINDOW)
        real_lines, simulated_lines = (_told(trace, line, end) for trace in (real, fake))
        simulated_lines = [value for value in simulated_lines if value is not late]
        if real_lines and not simulated_lines:
            # The real answer was just before the next request, so the fake's may be just after it.
            simulated_lines = _told(fake, line, end + PARAMETER_TIME)[:1]
            late = simulated_lines[0] if simulated_lines else None
        what = f"{line.t:.1f} {_question(line)}"
        real_value, other = _value(real_lines), _value(simulated_lines)
        if real_value != other:
            yield Difference(f"{what}: {real_value} / {other}")
        elif real_lines and abs(real_lines[0].t - simulated_lines[0].t) > PARAMETER_TIME:
            times = Figures(real_lines[0].t - line.t, simulated_lines[0].t - line.t, PARAMETER_TIME)
            yield Difference(f"{what}: time", figures=times)


def _name(line: Line) -> object:
    return line.fields.get("param_id") or line.fields.get("param_index")


def _told(trace: Trace, line: Line, end: float) -> list[Line]:
    name = line.fields.get("param_id")
    values = trace.between(line.t, end, "PARAM_VALUE", "PARAM_ERROR")
    if name:
        return [value for value in values if value.fields["param_id"] == name]
    return [value for value in values if value.fields.get("param_index") == line.fields.get("param_index")]


def _question(line: Line) -> str:
    if line.type == "PARAM_SET":
        value, kind = line.get("param_value"), line.fields["param_type"]
        return f"set {line.fields['param_id']} = {value:.4g} as type {kind}"
    return f"read {line.fields['param_id'] or line.fields['param_index']}"


def _value(lines: list[Line]) -> str:
    if not lines:
        return "silence"
    line = lines[0]
    if line.type == "PARAM_ERROR":
        return "PARAM_ERROR"
    index = "no index" if line.fields["param_index"] in (65535, -1) else "its index"
    times = f", {len(lines)} times" if len(lines) > 1 else ""
    return f"{line.get('param_value'):.4g} type {line.fields['param_type']} {index}{times}"


# -- plans -----------------------------------------------------------------------------------------------


def _plans(real: Trace, fake: Trace) -> Iterator[Difference]:
    requests = [line for line in real.inputs if line.type in ASKING]
    for number, line in enumerate(requests):
        after = requests[number + 1].t if number + 1 < len(requests) else line.t + PLAN_WINDOW
        end = min(after, line.t + PLAN_WINDOW)
        real_lines, simulated_lines = (trace.between(line.t, end, *PLANS) for trace in (real, fake))
        what = f"{line.t:.2f} {_brief(line)}"
        real_value, other = (
            ", ".join(_brief(each) for each in lines) or "nothing" for lines in (real_lines, simulated_lines)
        )
        if real_value != other:
            yield Difference(f"{what}: {real_value} / {other}")
        elif (
            apart := max(
                (abs(a.t - b.t) for a, b in zip(real_lines, simulated_lines, strict=True)), default=0.0
            )
        ) > PLAN_TIME:
            yield Difference(
                f"{what}: times",
                f"{[round(a.t - line.t, 2) for a in real_lines]} / "
                f"{[round(b.t - line.t, 2) for b in simulated_lines]}",
                Figures(None, apart, PLAN_TIME),
            )


def _brief(line: Line) -> str:
    fields = line.fields
    if line.type == "MISSION_COUNT":
        text = f"COUNT {fields['count']}"
    elif line.type.startswith("MISSION_ITEM"):
        # Item 0 is home, whose height depends on the place.
        height = "" if fields["frame"] == 0 else f" z {line.get('z'):.0f}"
        text = f"{line.type[8:]} {fields['seq']} frame {fields['frame']} command {fields['command']}{height}"
        text += f" current {fields['current']}" if fields["current"] else ""
    elif line.type == "MISSION_ACK":
        text = f"ACK {fields['type']}"
    else:
        text = f"{line.type[8:]} {fields.get('seq', '')}".strip()
    return text + (f" of plan {fields['mission_type']}" if fields.get("mission_type") else "")


def _reached(real: Trace, fake: Trace) -> Iterator[Difference]:
    starts = [line.t for line in real.inputs if line.fields.get("command") == 300]
    real_lines, simulated_lines = real.out("MISSION_ITEM_REACHED"), fake.out("MISSION_ITEM_REACHED")
    for seq in sorted({int(line.get("seq")) for line in [*real_lines, *simulated_lines]}):
        a, b = (
            [line.t for line in lines if line.get("seq") == seq] for lines in (real_lines, simulated_lines)
        )
        if not a or not b:
            yield Difference(f"item {seq} reached: {'never' if not b else 'too much'}", f"{a} / {b}")
            continue
        since = max((t for t in starts if t <= a[0]), default=0.0)
        if abs(a[0] - b[0]) > REACH_TIME + REACH_SHARE * (a[0] - since):
            yield Difference(f"item {seq} reached: time", figures=Figures(a[0], b[0], REACH_TIME))
        if (len(a) > 1) != (len(b) > 1):
            repetition = "once" if len(a) > 1 else "again and again"
            yield Difference(f"item {seq} reached: told {repetition}", f"{len(a)} / {len(b)}")


def _logs(real: Trace, fake: Trace) -> Iterator[Difference]:
    for line in real.inputs:
        if line.type == "LOG_REQUEST_LIST":
            real_lines, simulated_lines = (
                len(trace.between(line.t, line.t + 2.0, "LOG_ENTRY")) for trace in (real, fake)
            )
            if (real_lines > 0) != (simulated_lines > 0):
                yield Difference(f"{line.t:.1f} log entries: {real_lines} / {simulated_lines}")


# -- files -----------------------------------------------------------------------------------------------

ERRORS = (
    "NONE", "FAIL", "FAIL_ERRNO", "INVALID_DATA_SIZE", "INVALID_SESSION", "NO_SESSIONS", "EOF",
    "UNKNOWN_COMMAND", "EXISTS", "PROTECTED", "FILE_NOT_FOUND",
)  # fmt: skip


def _files(real: Trace, fake: Trace) -> Iterator[Difference]:
    """Compares the recorder's conclusions with the fake's replies, as the recorder omitted the replies."""
    block: list[Line] = []
    for line in real.lines:
        if line.type == "FTP":
            block.append(line)
        elif line.dir == "note" and block:
            yield from _block(fake, line.text.removeprefix("FACT "), block)
            block = []


def _block(fake: Trace, text: str, asked: list[Line]) -> Iterator[Difference]:
    expected = _results(text, asked)
    for line, result in zip(asked, expected, strict=True):
        reply = _reply(fake, line)
        answer = "no answer" if reply is None else _word(reply)
        if result and result != answer:
            name = str(line.fields["data"]).replace("\0", " ") if line.fields["op"] != "write" else ""
            yield Difference(f"file {line.fields['seq']} {line.fields['op']} {name}: {result} / {answer}")
        elif reply is not None and not reply.fields["nak"]:
            yield from _contents(text, line, reply, alone=len(asked) == 1)


def _contents(text: str, line: Line, reply: Line, *, alone: bool) -> Iterator[Difference]:
    """Compares the recorded size, checksum, or bytes of the only reply."""
    pattern = {"open_ro": r"size told (\d+)", "crc": r"CRC (?:of it: )?(0x[0-9a-f]+)"}.get(line.fields["op"])
    noted = re.search(pattern, text) if pattern else None
    data = re.search(r"ACK session \d+ size \d+ offset \d+ data (b'.*'|b\".*\")$", text) if alone else None
    what = f"file {line.fields['seq']} {line.fields['op']}"
    if noted and int(noted[1], 0) != int.from_bytes(reply.fields["data"][:4], "little"):
        size_or_sum = "size" if line.fields["op"] == "open_ro" else "checksum"
        yield Difference(f"{what}: another {size_or_sum}", noted[1])
    elif data and ast.literal_eval(data[1]) != reply.fields["data"]:
        yield Difference(f"{what}: other bytes", f"{data[1]} / {reply.fields['data']!r}")


def _results(text: str, asked: list[Line]) -> list[str]:
    """The recorded answer to each request, "" where it is unknown."""
    answers = [f"NAK {name}" if name else "ACK" for name in re.findall(r"(?:NAK (\w+)|\bACK\b)", text)]
    if "size told" in text:
        return [
            {"open_ro": "ACK", "terminate": "ACK", "crc": "ACK"}.get(line.fields["op"], "") for line in asked
        ]
    if len(answers) == len(asked):
        return answers
    if len(asked) == 1 and not answers:
        return ["ACK"]
    return [""] * len(asked)


def _reply(fake: Trace, line: Line) -> Line | None:
    seq = (int(line.fields["seq"]) + 1) & 0xFFFF
    replies = fake.between(line.t, line.t + 0.5, "FILE_TRANSFER_PROTOCOL")
    return next((reply for reply in replies if reply.fields["seq"] == seq), None)


def _word(reply: Line) -> str:
    if not reply.fields["nak"]:
        return "ACK"
    number = reply.fields["data"][0]
    return f"NAK {ERRORS[number] if number < len(ERRORS) else number}"
