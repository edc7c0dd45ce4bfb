"""Mission and parameter files of ground stations: bytes in, values out. Independent of any vehicle."""
