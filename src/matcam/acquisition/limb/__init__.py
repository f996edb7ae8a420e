"""Limb of a sphere in an image: its circle, its edges, and the reflection of a bright field."""
