"""Table of diagnostics of the DBC reader: code, sentence, hint.

DBC1xx are errors: the file is not used. DBC9xx are warnings: a part of the file is ignored.
"""

from __future__ import annotations

from lfield.driver import FindingTable

#: Every message by its code, ordered by code.
TABLE = FindingTable("DBC", warnings="DBC9")
_message = TABLE.message

# --- DBC1xx: the file is not used -----------------------------------------------------------------------

NOT_DBC = _message(
    "DBC101",
    "this is not a DBC file: it has none of its statements",
    "a message is 'BO_ ID NAME: LENGTH SENDER'",
)
SYNTAX = _message("DBC102", "expected {what}, found {found}", "{form}")
STRAY_SIGNAL = _message(
    "DBC103", "signal {signal} is outside a message", "put it below the line 'BO_' of its message"
)
UNCLOSED_TEXT = _message("DBC104", "this text is not closed before the end of the file", 'close it with "')

# --- DBC9xx: a part of the file is not used -------------------------------------------------------------

BEYOND_FRAME = _message(
    "DBC901",
    "signal {signal} is beyond its frame: it ends in byte {end}, but {message} has {length}",
    "correct its position or the length of the message; the other signals are used",
)
NO_SUCH_ID = _message(
    "DBC902",
    "message {message} is ignored: no CAN frame has the id {id}",
    "an id has 11 bits, or 29 bits and bit 31 set",
)
TOO_LONG = _message(
    "DBC903",
    "message {message} is ignored: no CAN frame has {length} bytes",
    "a frame has up to 8 bytes, of CAN FD up to 64; messages in several frames are not supported",
)
NO_BITS = _message(
    "DBC904",
    "signal {signal} is ignored: {reason}",
    "a signal has 1 to 64 bits, a float 16, 32 or 64; the other signals are used",
)
DUPLICATE = _message(
    "DBC905",
    "{what} {name} is also in line {line}; this one is ignored",
    "use different names; the first is used",
)
NO_MULTIPLEXER = _message(
    "DBC906",
    "signal {signal} is ignored: {message} has no multiplexer {name}",
    "mark the signal that selects it with 'M'; the other signals are used",
)
NO_NAME = _message("DBC907", "{what} has no name and is ignored", "give it a name to use it")
UNKNOWN = _message(
    "DBC908", "'{keyword}' is not a statement of a DBC file and is ignored", "check its spelling"
)
NOT_EXTENDED = _message(
    "DBC909",
    "the id {id} of message {message} has more than 11 bits, but not bit 31: it is used as an extended id",
    "add 2147483648 to the id in the file",
)
MISSING = _message(
    "DBC910", "{statement} refers to {what}, which is not in the file, and is ignored", "remove it"
)
UNENDED = _message("DBC911", "this statement does not end with ';'", "put ';' at its end")
NO_RANGE = _message(
    "DBC912",
    "the range of signal {signal}, from {low} to {high}, is empty and is ignored",
    "write the lower number first; [0|0] means no range",
)
NO_MESSAGES = _message(
    "DBC914", "the file describes no CAN messages", "a message is 'BO_ ID NAME: LENGTH SENDER'"
)
SMALL_MARK = _message(
    "DBC915",
    "the mark 'm' of signal {signal} has no number and is used as 'M'",
    "write 'M' for a multiplexer",
)
NO_VALUES = _message(
    "DBC916",
    "the range of signal {signal}, from {low} to {high}, contains no value of its bits and is ignored",
    "correct its range, or its factor and offset",
)
NO_SCALE = _message("DBC913", "the factor of signal {signal} is 0; 1 is used", "write its factor")
