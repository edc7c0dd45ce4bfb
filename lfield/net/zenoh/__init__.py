"""Zenoh as a transport: numbered streams over publications of an existing fabric of routers or peers."""
