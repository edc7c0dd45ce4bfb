"""The table of log lines: each line has a stable code, a level and a template.

A host logs only the `LogLine`s that `LogMessage.line` makes. Drivers have tables of their own, with
`LogMessage`s of the same kind. `lfield/docs/messages.md` lists all tables; events carry code and level
(`lfield events --json`).

A message is in the module of its subject: `host` (its journal and clock, the input of its operator, the end
of a run of all hosts), `agents` (with leases and failover), `links` (with the commands of operators),
`devices` (with the reports of guards and drivers).
"""

from __future__ import annotations

from lfield.text.log_messages.agents import *
from lfield.text.log_messages.devices import *
from lfield.text.log_messages.host import *
from lfield.text.log_messages.links import *
from lfield.text.log_messages.log_line import *

#: The lines of hosts by their code; the lines of devices are in `DEVICE_MESSAGES`.
LOG_MESSAGES: dict[str, LogMessage] = {**HOST, **AGENTS, **LINKS, **DEVICES}
