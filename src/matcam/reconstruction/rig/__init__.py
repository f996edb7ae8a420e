"""JSON document of a reconstruction's rig, and its use as a prior of another reconstruction."""
