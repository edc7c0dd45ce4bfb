"""DBC files: what they describe, and frames encoded and decoded by it. Pure but for reading the file."""

from lfield_can.dbc.file import DbcError, DbcFile, Term
from lfield_can.dbc.layout import Message, Signal, representable

__all__ = ["DbcError", "DbcFile", "Message", "Signal", "Term", "representable"]
