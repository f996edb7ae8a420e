"""Comparison of highlights with a table of lamps."""
