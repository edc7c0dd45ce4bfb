"""Recording files: framed records in rings of segments, written in the background and readable when cut."""
