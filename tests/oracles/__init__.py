"""Slow transcriptions of the definitions, which check the compiled core."""
