"""Location of coordinators: hops, membership, leases, failover (chapter III, appendix I). Sans-IO."""
