"""From observations to the material: the joint fit of pictures of a sphere, and what is written of it."""
