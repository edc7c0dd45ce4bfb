"""Logs of the data that drivers send and receive, in the formats of the usual tools."""

from lfield.driver.recording.wire_log import WireLog

__all__ = ["WireLog"]
