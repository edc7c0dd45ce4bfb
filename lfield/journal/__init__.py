"""Durable state of a host: the journal, its records, and its recovery after damage."""
