"""Memory of a process that does many jobs."""

import gc
import weakref

import pytest

from matcam.core import memory
from matcam.core.memory import free_for_the_next


class Ring:
    """An object that only a collection frees."""

    def __init__(self):
        self.own = self


@pytest.fixture
def unfrozen():
    frozen = gc.get_freeze_count()
    gc.unfreeze()
    memory._freeze.cache_clear()
    yield
    gc.unfreeze()
    if frozen:
        gc.freeze()


def test_what_a_job_leaves_is_freed(unfrozen):
    for _ in range(2):  # the first time all else is frozen
        left = weakref.ref(Ring())
        assert left() is not None
        free_for_the_next()
        assert left() is None
    assert gc.get_freeze_count() > 0
