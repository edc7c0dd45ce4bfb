"""Durable state of a host: journal writes, records, and recovery after damage."""
