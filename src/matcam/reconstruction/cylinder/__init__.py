"""Reconstruction from photographs of a cylinder with strips of material of several orientations."""
