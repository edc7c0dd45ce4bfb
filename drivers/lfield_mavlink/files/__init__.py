"""Mission and parameter files of ground stations: bytes in, values out. Nothing here knows a vehicle."""
