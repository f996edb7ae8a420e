"""Observations from photographs of a sample under a moved lamp: linear values, their noise, and the geometry."""
