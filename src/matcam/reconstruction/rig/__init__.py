"""Rig of a reconstruction: its lens over the field, and results of an earlier reconstruction."""
