"""Diagnostics of files (L6xx) and deployments (L7xx)."""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

MISSION_FILES = FindingTable("L6", "L7", warnings="L9")
_message = MISSION_FILES.message

# --- L6xx: files ----------------------------------------------------------------------------------------

INCLUDE_MISSING = _message(
    "L601", "there is no file {path}", "the path is relative to the file with the include"
)
INCLUDE_UNREADABLE = _message("L602", "cannot read {path}: {reason}", "check the path and its permissions")
INCLUDE_UNKNOWN = _message(
    "L603",
    "no installed package has the include <{path}>",
    'install the driver it comes with; files of your own are included as "file.L"',
)
INCLUDE_SYNTAX = _message(
    "L604", "an include names one file", 'write include "file.L"; or include <name/file.L>;'
)
NOT_UTF8 = _message("L605", "the file is not UTF-8 here (byte {byte})", "save it as UTF-8 text")

# --- L7xx: deployments ----------------------------------------------------------------------------------

DEPLOY_SYNTAX = _message(
    "L701",
    "{problem}",
    "a line is //Type:id@host or //Type:id@host:port?argument&argument, or //@host for one without agents",
)
DEPLOY_TYPE = _message("L702", "the program has no resource or coordinator '{name}'", "it has {known}")
DEPLOY_CLASS = _message(
    "L703", "'{name}' is a class", "only resources and coordinators are deployed: {known}"
)
DEPLOY_ID = _message(
    "L704", "the id '{id}' is not valid", "an id consists of letters, digits, '.', '_' and '-'"
)
DEPLOY_DUPLICATE = _message(
    "L705", "the id '{id}' is already used on line {line}", "ids are unique in a deployment"
)
DEPLOY_HOST = _message(
    "L706",
    "the host '{host}' is not valid",
    "a host is a name or an address of letters, digits, '.', '_' and '-', at most 253 of them, or [::1]",
)
DEPLOY_PORT = _message("L707", "the port '{port}' is not valid", "a port is a number from 1 to 65535")
DEPLOY_TWO_PORTS = _message(
    "L708",
    "{host} has port {first} on line {line}, here {port}",
    "a host listens on one port: write the same one on all its lines",
)
DEPLOY_HOST_CASE = _message(
    "L709",
    "'{host}' is written '{first}' on line {line}",
    "host names are case-insensitive: use one spelling",
)
DEPLOY_ESCAPE = _message(
    "L710",
    "'{escape}' is not a percent escape of UTF-8 text",
    "write %25 for %, %26 for &, %23 for #, %20 for a space",
)
DEPLOY_SPACE = _message(
    "L711", "a space is not allowed here", "write %20 in an argument; a comment begins with #"
)
DEPLOY_EMPTY = _message("L712", "the deployment is empty", "write one line //Type:id@host for every agent")
DEPLOY_NO_PROGRAM = _message(
    "L713",
    "the program has no resources and no coordinators, so there is no '{name}' to deploy",
    "check that this deployment belongs to this program",
)
DEPLOY_NOT_TEXT = _message(
    "L714", "the deployment is not UTF-8 text here (byte {byte})", "save it as UTF-8 text"
)
DEPLOY_WITNESS = _message(
    "L715", "{host} is already on line {line}", "remove this line: it is for a host without agents"
)

MISSING_ARGUMENT = _message(
    "L716",
    "{agent} has {count}, and its init reads arg[{index}] on line {line} of the program",
    "end the line of {agent} with ?{given}",
)

UNKNOWN_STARTABLE = _message(
    "L717", "the deployment has no coordinator '{id}'", "{function} takes the id of a startable coordinator"
)
NOT_STARTABLE = _message(
    "L718",
    "'{id}' is not startable",
    "write startable before its line in the deployment: it then starts only when a coordinator starts it",
)
DEPLOY_STARTABLE = _message(
    "L719", "'{id}' is a resource: resources start with their hosts", "remove startable from this line"
)
