"""`reserve`: what a coordinator keeps for itself, host by host (decision 53)."""
