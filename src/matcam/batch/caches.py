"""What is worth keeping on disk between processes: compiled functions, and what depends on a rig alone."""

from __future__ import annotations

import os
from pathlib import Path


def keep_rules() -> None:
    """Keep both in the user's cache folder from now on. A process of ours may; a library must not choose this for its user."""
    from matcam._jax import use_compilation_cache
    from matcam.inverse import rule_cache

    use_compilation_cache()
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    rule_cache.use_folder(Path(root) / "matcam" / "rules")
