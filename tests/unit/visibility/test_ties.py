# SPDX-License-Identifier: Apache-2.0
"""Scores that are equal but for rounding."""

import numpy as np
import pytest

from multilica.results.visibility_score import VisibilityScore


def _score(agree, on_the_main_plane):
    information = np.diag([0.0, 0.0, 0.0, on_the_main_plane, 0.0, 0.0])
    return VisibilityScore(agree, 0, 0, 0, information, np.zeros(0, dtype=np.uint8))


@pytest.mark.parametrize("rounding", [-1e-12, 0.0, 1e-12])
def test_evidence_does_not_depend_on_rounding(rounding):
    assert _score(90, 40.0 + rounding).evidence == _score(90, 40.0).evidence
    assert str(_score(40, 40.0 + rounding).evidence) == "0.0"
