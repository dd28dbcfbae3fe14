# SPDX-License-Identifier: Apache-2.0
import sys
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from jinja2 import Environment

from multilica.sinks.report import page, template


@pytest.fixture
def compiled(tmp_path, monkeypatch):
    """Where Python keeps the compiled module."""
    monkeypatch.setattr(sys, "pycache_prefix", str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    return Path(cache_from_source(template.__file__)).parent


def _loaded():
    return page._template.__wrapped__()


def test_a_template_is_compiled_once(compiled, monkeypatch):
    compiled.mkdir(parents=True)
    _loaded()
    (kept,) = compiled.iterdir()
    monkeypatch.setattr(Environment, "_generate", None)
    _loaded()
    assert kept.suffix == ".jinja"


def test_without_a_place_to_write_it_is_compiled_each_time(compiled):
    _loaded()
    assert not compiled.exists()


def test_no_template_is_kept_where_python_keeps_no_module(compiled, monkeypatch):
    compiled.mkdir(parents=True)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    _loaded()
    assert list(compiled.iterdir()) == []
