"""Compact coding of what a link carries: transfers as deltas, messages as compressed streams. Sans-IO."""
