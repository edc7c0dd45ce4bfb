"""The page of `lfield watch --replay`: recordings as a team whose time can be moved."""
