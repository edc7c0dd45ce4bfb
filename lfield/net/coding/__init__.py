"""Compact coding of the data of a link: transfers as deltas, messages as compressed streams. Sans-IO."""
