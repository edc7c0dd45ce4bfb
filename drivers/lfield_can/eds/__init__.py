"""EDS files (CiA 306): the objects of a drive and their types. Pure except for reading the file."""

from lfield_can.eds.eds_reader import EdsError, parse_eds

__all__ = ["EdsError", "parse_eds"]
