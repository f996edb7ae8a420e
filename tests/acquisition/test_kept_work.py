"""A run that was cut off goes on: what was read of the frames is kept, and believed only where the frames are the same."""

import os

import numpy as np
import pytest

from matcam.acquisition.light.kept_work import KeptWork, identity
from matcam.acquisition.merging import merge
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.core.errors import FileFormatError
from matcam.core.threads import in_order
from matcam.files.capture import read_capture
from tests.acquisition.drawn import small


@pytest.fixture
def reads(monkeypatch):
    """Files of the sample that are decoded, in their order."""
    found = []
    original = MosaicReader.read

    def read(self, frame, region=None):
        found.append(frame.file)
        return original(self, frame, region)

    monkeypatch.setattr(MosaicReader, "read", read)
    return found


def test_a_run_that_was_cut_off_goes_on(tmp_path, reads):
    capture = read_capture(small(cfa=None).write(tmp_path / "shots"))
    folder = tmp_path / "kept"
    plain, radiometry = merge(capture)

    def stop(step, done, total):
        if (step, done) == ("merging", 2):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge(capture, progress=stop, kept=KeptWork(folder))
    reads.clear()
    kept = KeptWork(folder)
    again, other = merge(capture, kept=kept, workers=2)
    # one frame of each exposure tells the darkest codes; of what was merged before no other is read
    lamps = [name.split("/")[1][:3] for name in reads if name.startswith("frames/")]
    assert lamps.count("L01") == 0
    assert lamps.count("L00") == 5
    assert lamps.count("L02") == lamps.count("L03") == 5
    assert other.exposures == radiometry.exposures
    assert [str(one) for one in other.remarks] == [str(one) for one in radiometry.remarks]
    for one, two in zip(plain, again, strict=True):
        for name in ("values", "std", "clipped", "channel"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert one.origin == two.origin
    assert list(folder.iterdir())
    kept.clear()
    assert not list(folder.iterdir())


def test_frames_that_changed_are_read_again(tmp_path, reads):
    drawn = small(cfa=None)
    folder = drawn.write(tmp_path / "shots")
    merge(read_capture(folder), kept=KeptWork(tmp_path / "kept"))
    path = folder / "frames/L02_E0.tif"
    before = identity([path])
    os.utime(path, ns=(1, path.stat().st_mtime_ns + 10**9))
    assert identity([path]) != before
    reads.clear()
    merge(read_capture(folder), kept=KeptWork(tmp_path / "kept"))
    assert sum(name.startswith("frames/L02") for name in reads) >= 10
    assert not any(name.startswith("frames/L01") for name in reads)


def test_a_frame_that_could_not_be_read_is_tried_again(tmp_path, monkeypatch):
    capture = read_capture(small(cfa=None).write(tmp_path / "shots"))
    original, kept = MosaicReader.read, tmp_path / "kept"

    def fail(self, frame, region=None):
        if frame.lamp == "L02":
            raise FileFormatError(f"{frame.file}: was not read in 20 s")
        return original(self, frame, region)

    with monkeypatch.context() as slow:
        slow.setattr(MosaicReader, "read", fail)
        few, radiometry = merge(capture, kept=KeptWork(kept))
    assert len(few) == 3
    assert sum("was not read" in str(one) for one in radiometry.remarks) == 5
    again, radiometry = merge(capture, kept=KeptWork(kept))
    assert len(again) == 4
    assert not any("was not read" in str(one) for one in radiometry.remarks)


def test_what_is_damaged_is_made_again(tmp_path):
    kept = KeptWork(tmp_path)
    kept.store("a", lambda: {"value": np.arange(3)})
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-40] + bytes(40))
    assert kept.store("a", lambda: {"value": np.arange(4)})["value"].size == 4


@pytest.mark.parametrize("workers", [1, 2, 5, 40])
def test_threads_keep_the_order(workers):
    assert list(in_order(lambda n: n * n, list(range(17)), workers)) == [n * n for n in range(17)]
    assert list(in_order(abs, [], workers)) == []


def test_several_workers_read_the_same(tmp_path):
    capture = read_capture(small().write(tmp_path))
    one, two = (merge(capture, workers=n) for n in (1, 3))
    assert one[1].to_dict() == two[1].to_dict()
    for a, b in zip(one[0], two[0], strict=True):
        np.testing.assert_array_equal(a.values, b.values)
