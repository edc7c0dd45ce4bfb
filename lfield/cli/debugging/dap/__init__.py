"""The server of the Debug Adapter Protocol, for editors."""
