"""`together`: portal calls are collected, started, fetched and cancelled (decision 46)."""
