"""Stories: drawn from seeds, told, judged, made smaller."""
