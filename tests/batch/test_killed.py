"""Commands that are killed at random moments: nothing half-written, a rerun succeeds, finished work is untouched."""

import os

import pytest

from tests.batch.kills import COMMANDS, adopt_orphans, kill_at_random


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", COMMANDS)
def test_killed_at_a_random_moment(tmp_path, name):
    """30 times each, 240 in all; MATCAM_TEST_KILLS says how many of each instead."""
    adopt_orphans()
    tally = kill_at_random(name, tmp_path, int(os.environ.get("MATCAM_TEST_KILLS", "30")))
    print(name, tally.ended, tally.ratio)
    assert tally.faults == []
