"""`reserve`: exclusive resources of a coordinator, granted host by host (decision 53)."""
