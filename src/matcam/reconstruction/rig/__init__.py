"""JSON document of the rig of a reconstruction, and use of this rig as a prior of another reconstruction."""
