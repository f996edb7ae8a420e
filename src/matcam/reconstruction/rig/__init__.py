"""What a rig brings to a reconstruction: its lens over the field, and what an earlier one found of it."""
