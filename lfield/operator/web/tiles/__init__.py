"""Backgrounds of the map: files of pictures, or the address of a server that the operator names."""
