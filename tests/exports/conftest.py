# SPDX-License-Identifier: Apache-2.0
"""The command line, as its own tests call it."""

from tests.cli.conftest import invoke

__all__ = ["invoke"]
