"""What a rig records of a search's starts is computed once, and kept on disk."""

import numpy as np
import pytest

from matcam import GGX, rigs
from matcam.core.workspace import Workspace
from matcam.inverse.fit import start_records
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.start_records import StartRecords
from matcam.inverse.operator.lobe_operator import lobe_operator


@pytest.fixture(scope="module")
def operator():
    return lobe_operator(rigs.merl(), "centre", 30)[1]


def test_records_are_those_of_the_operator_and_come_back(operator, tmp_path, monkeypatch):
    kind, starts = LobeKind("ggx", "smith"), np.log([[0.01], [0.1]])
    records = StartRecords((operator,), Workspace(tmp_path)).of(kind, starts)
    for (record,), (start,) in zip(records, starts, strict=True):
        np.testing.assert_allclose(record, operator.record(GGX(np.exp(start)), "smith", np.zeros(0)), rtol=1e-12)
    asked = []
    own = start_records.lobe_record
    monkeypatch.setattr(start_records, "lobe_record", lambda *given: asked.append(given) or own(*given))
    again = StartRecords((operator,), Workspace(tmp_path))
    np.testing.assert_array_equal(again.of(kind, starts), records)
    assert not asked
    again.of(kind, starts + 0.1)  # other lobes, masking or numbers of the operator are other records
    again.of(LobeKind("ggx", None), starts)
    assert len(asked) == 4
