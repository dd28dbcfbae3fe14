# SPDX-License-Identifier: Apache-2.0
from tests.cli.conftest import invoke

__all__ = ["invoke"]
