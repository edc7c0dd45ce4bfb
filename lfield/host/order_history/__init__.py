"""History of executed stop and pause orders: idempotence and replay protection."""
