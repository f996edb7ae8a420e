"""Public benchmark: recovering reflectance that a camera has blurred. docs/validation/recovery.md explains it."""
