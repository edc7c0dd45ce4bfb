"""EDS files (CiA 306): which objects a drive has, and of which type. Pure but for reading the file."""

from lfield_can.eds.reader import EdsError, parse_eds

__all__ = ["EdsError", "parse_eds"]
