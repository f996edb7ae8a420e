"""Light in the frames of a capture: brackets, white reference patch, flat field, and clipped pixels."""
