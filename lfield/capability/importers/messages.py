"""What can be wrong with a file that shall be imported: C18x."""

from __future__ import annotations

from lfield.text.findings import Message

OTHER_SPEC = Message("C180", "only version 1 of these specs is known", "it has 'spec_version: 1'")
UNKNOWN_FILE = Message(
    "C181",
    "this is neither a spec of ROS capabilities nor a VDA 5050 factsheet",
    "specs have 'spec_version' and 'interface', 'redefines' or 'implements'; "
    "factsheets are JSON with 'typeSpecification'",
)
NOT_JSON = Message("C182", "this is not JSON: {reason}")
