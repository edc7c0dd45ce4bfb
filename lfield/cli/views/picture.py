"""A team as a table: who is where, how every device is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group
from rich.table import Table

from lfield.errors import LfieldError

#: What every host answered, or the error that stood in the way.
Answers = Mapping[str, dict[str, Any] | LfieldError]

#: So many quantities of a device are shown, the first of its manifest; `lfield ps --json` has all.
SHOWN = 8
#: A device that has not been heard for longer (seconds) is shown as silent: its telemetry is old.
SILENT = 3.0


def picture(answers: Answers) -> Group:
    """The agents of all hosts with the coordinators that have ended or are in doubt, then the devices."""
    devices = _devices(answers)
    return Group(_agents(answers), "", devices) if devices.row_count else Group(_agents(answers))


def _devices(answers: Answers) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "DEVICE", "STATE", "TELEMETRY"):
        shown.add_column(column)
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        for name, values in answer["devices"].items():
            state = _device_state(name, answer)
            words = [f"{quantity} {_value(value)}" for quantity, value in list(values.items())[:SHOWN]]
            words += [f"and {len(values) - SHOWN} more"] if len(values) > SHOWN else []
            shown.add_row(host, name, state, ", ".join(words))
    return shown


def _device_state(name: str, answer: dict[str, Any]) -> str:
    silence = answer["silences"].get(name, 0.0)
    if silence > SILENT:
        return f"silent {silence:.0f} s"
    return "safe" if name in answer["latched"] else "in use"


def _value(value: object) -> str:
    if isinstance(value, list):
        return f"({' '.join(_value(part) for part in value)})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _agents(answers: Answers) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "AGENT", "TYPE", "STATE", "HOPS", "SERVED", "HEAP"):
        shown.add_column(column, justify="right" if column in ("HOPS", "SERVED", "HEAP") else "left")
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            shown.add_row(host, "-", "", "no answer", "", "", "")
            continue
        for agent in answer["agents"]:
            hops = str(agent["hops"]) if agent["kind"] == "coordinator" else ""
            served = str(agent["served"]) if agent["kind"] == "resource" else ""
            shown.add_row(
                host, agent["id"], agent["type"], agent["state"], hops, served, _size(agent["heap"])
            )
        for record in answer["coordinators"]:
            if record["state"] == "IN DOUBT" or (record["state"] == "EXITED" and record["where"] == host):
                state = f"{record['outcome'] or 'in doubt'}: {record['detail']}".splitlines()[0].rstrip(": ")
                shown.add_row(host, record["id"], "", state, str(record["hops"]), "", "")
    return shown


def _size(count: int) -> str:
    return f"{count} B" if count < 1024 else f"{count / 1024:.1f} KiB"
