"""Light of frames: a white patch beside the sphere, and the uniformity of the pixels."""
