"""Location of coordinators: hand-over, membership, leases, failover (chapter III, appendix I). Sans-IO."""
