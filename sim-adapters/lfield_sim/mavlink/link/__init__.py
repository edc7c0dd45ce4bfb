"""Bytes to messages and back, by way of air that loses, breaks and delays them; signing."""
