"""THE table of what the reader of EDS files can say: code, sentence, hint.

EDS1xx are errors: the file is not used. EDS9xx are warnings: the file is used without what they are about.
"""

from __future__ import annotations

from lfield.driver import Table

#: Every message by its code, in the order of the codes.
TABLE = Table(warnings="EDS9")
_message = TABLE.message

# --- EDS1xx: the file is not used -----------------------------------------------------------------------

NO_OBJECTS = _message(
    "EDS101", "the file describes no objects", "an object has a section of its own, as in [6040]"
)

# --- EDS9xx: a part of the file is not used -------------------------------------------------------------

NOT_A_LINE = _message(
    "EDS901", "this line is left out: it is no section and has no '='", "write KEY=VALUE, or ; for a comment"
)
TWICE = _message("EDS902", "{what} stands in line {line}, too; the first is used", "keep one of them")
NOT_A_NUMBER = _message(
    "EDS903",
    "object {object} is left out: its {key} is '{text}', which is no number",
    "write it like 7 or 0x0007",
)
NO_TYPE = _message(
    "EDS904", "object {object} is left out: it has no DataType", "give it the DataType of the manual"
)
UNKNOWN_TYPE = _message(
    "EDS905",
    "object {object} is left out: the file does not say what its DataType {type} is",
    "describe the type in a section of its own, or use one of CiA 301",
)
