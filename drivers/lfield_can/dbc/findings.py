"""THE table of what the reader of DBC files can say: code, sentence, hint.

DBC1xx are errors: the file is not used. DBC9xx are warnings: the file is used without what they are about.
"""

from __future__ import annotations

from lfield.driver import Table

#: Every message by its code, in the order of the codes.
TABLE = Table(warnings="DBC9")
_message = TABLE.message

# --- DBC1xx: the file is not used -----------------------------------------------------------------------

NOT_DBC = _message(
    "DBC101",
    "this is no DBC file: it has none of its statements",
    "a message is 'BO_ ID NAME: LENGTH SENDER'",
)
SYNTAX = _message("DBC102", "expected {what}, found {found}", "{form}")
STRAY_SIGNAL = _message(
    "DBC103", "signal {signal} stands outside a message", "put it below the line 'BO_' of its message"
)
UNCLOSED_TEXT = _message("DBC104", "this text is not closed before the end of the file", 'close it with "')

# --- DBC9xx: a part of the file is not used -------------------------------------------------------------

BEYOND = _message(
    "DBC901",
    "signal {signal} lies beyond its frame: it ends in byte {end}, and {message} has {length}",
    "correct its place or the length of the message; the other signals are used",
)
NO_SUCH_ID = _message(
    "DBC902",
    "message {message} is left out: no CAN frame has the id {id}",
    "an id has 11 bits, or 29 bits and bit 31 set",
)
TOO_LONG = _message(
    "DBC903",
    "message {message} is left out: no CAN frame has {length} bytes",
    "a frame has up to 8 bytes, of CAN FD up to 64; what is sent in several frames cannot be read here",
)
NO_BITS = _message(
    "DBC904",
    "signal {signal} is left out: {reason}",
    "a signal has 1 to 64 bits, a float 16, 32 or 64; the other signals are used",
)
TWICE = _message(
    "DBC905",
    "{what} {name} stands in line {line}, too, and is left out",
    "give each its own; the first is used",
)
NO_MULTIPLEXER = _message(
    "DBC906",
    "signal {signal} is left out: {message} has no multiplexer {name}",
    "mark the signal that selects it with 'M'; the other signals are used",
)
NO_NAME = _message("DBC907", "{what} has no name and is left out", "give it a name to use it")
UNKNOWN = _message(
    "DBC908", "'{word}' is no statement of a DBC file and is left out", "look whether it is misspelt"
)
NOT_EXTENDED = _message(
    "DBC909",
    "the id {id} of message {message} has more than 11 bits and not bit 31: it is taken for an extended id",
    "add 2147483648 to the id in the file",
)
ABSENT = _message(
    "DBC910", "{statement} is about {what}, which the file does not have, and is left out", "remove it"
)
UNENDED = _message("DBC911", "this statement does not end with ';'", "put ';' at its end")
NO_RANGE = _message(
    "DBC912",
    "the range of signal {signal}, from {low} to {high}, is empty and is left out",
    "write the lower number first; [0|0] is no range",
)
NO_MESSAGES = _message(
    "DBC914", "the file describes no CAN messages", "a message is 'BO_ ID NAME: LENGTH SENDER'"
)
SMALL_MARK = _message(
    "DBC915",
    "the mark 'm' of signal {signal} has no number and is taken for 'M'",
    "write 'M' for a multiplexer",
)
NO_VALUES = _message(
    "DBC916",
    "the range of signal {signal}, from {low} to {high}, has no value that its bits can hold and is left out",
    "correct its range, or its factor and offset",
)
NO_SCALE = _message("DBC913", "the factor of signal {signal} is 0; 1 is used", "write its factor")
