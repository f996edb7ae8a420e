"""Rig of a reconstruction: its document, and the rig of an earlier reconstruction."""
