"""DBC files: parsing, and frames encoded and decoded by them. Pure except for reading the file."""

from lfield_can.dbc.dbc_file import DbcError, DbcFile, Term
from lfield_can.dbc.layout import Message, Signal, representable
from lfield_can.dbc.protection import Protection, protections

__all__ = ["DbcError", "DbcFile", "Message", "Protection", "Signal", "Term", "protections", "representable"]
