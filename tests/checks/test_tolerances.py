# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from multilica.checks import RigTolerances, Tolerance, read_tolerances
from multilica.errors import SourceNotFoundError, UnreadableSourceError

DEFAULT = Tolerance(translation_m=0.02, rotation_deg=0.2)


def test_the_file_overrides_what_it_has(tmp_path):
    path = tmp_path / "tolerances.toml"
    path.write_text("[default]\nrotation_deg = 0.5\n[lidars.roof]\ntranslation_m = 0.1\n")
    found = read_tolerances(path, DEFAULT)
    assert found.of("front") == Tolerance(translation_m=0.02, rotation_deg=0.5)
    assert found.of("roof") == Tolerance(translation_m=0.1, rotation_deg=0.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[default]\ntranslation = 1.0", "translation"),
        ("[lidars.roof]\nrotation_deg = -1.0", "rotation_deg"),
        ("[default]\ntranslation_m = 1e300", "translation_m"),
        ("[default]\ntranslation_m = nan", "translation_m"),
        ("[default]\ntranslation_m = 0.0", "translation_m"),
        ("[default]\nrotation_deg = 180.1", "rotation_deg"),
        ("roof = 3", "roof"),
        ("[default", "not a TOML file"),
    ],
)
def test_other_content_is_refused_with_its_place(tmp_path, text, said):
    path = tmp_path / "tolerances.toml"
    path.write_text(text)
    with pytest.raises(UnreadableSourceError, match=said):
        read_tolerances(path, DEFAULT)


def test_without_a_file_it_is_three_centimetres():
    assert Tolerance().model_dump() == {"translation_m": 0.03, "rotation_deg": 0.3}
    assert RigTolerances().of("roof") == Tolerance()
    assert Tolerance(translation_m=100.0, rotation_deg=180.0)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(SourceNotFoundError, match="No file of tolerances"):
        read_tolerances(tmp_path / "none.toml", DEFAULT)
