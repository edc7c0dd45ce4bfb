"""Bytes to messages and back: endpoints and links, packets, signatures, and which link leads to a vehicle."""
