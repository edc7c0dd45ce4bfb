"""Areas, lines and findings of files that ground stations and map programs write. Pure: bytes in, values out.

KML (OGC 12-007r2) and GeoJSON (RFC 7946) are read here; mission files are read by drivers.
"""
