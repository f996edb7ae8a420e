"""What a capture states of its rig, as the prior of a fit: camera, lamps and their light, outline."""
