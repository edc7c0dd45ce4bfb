"""Diagnostics of the front end: code, sentence and hint of each.

`FindingKind.at` creates them; the page of messages is generated from this table. The first digit of a code
shows the module of the message: L1 and L2 in `syntax`, L3 and L4 in `names_and_types`, L5 in `scope`, L6
and L7 in `mission_files`, L8 and L9 in `coordination`.
"""

from __future__ import annotations

from lfield.lang.messages.coordination import *
from lfield.lang.messages.mission_files import *
from lfield.lang.messages.names_and_types import *
from lfield.lang.messages.scope import *
from lfield.lang.messages.syntax import *
from lfield.text.message_tables import FindingKind

#: Every message by its code.
TABLE: dict[str, FindingKind] = {**SYNTAX, **NAMES_AND_TYPES, **SCOPE, **MISSION_FILES, **COORDINATION}
