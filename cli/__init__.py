"""The `tspline` command."""
