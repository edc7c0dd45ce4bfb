"""Leave, travel, arrive, end: what becomes of coordinators (chapter III, appendix I). Pure."""
