"""The host that holds each coordinator, as the other hosts report it. Pure."""
