"""What light a frame was taken in: a white patch beside the sphere, and how evenly the pixels see."""
