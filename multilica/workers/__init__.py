# SPDX-License-Identifier: Apache-2.0
"""Worker processes: the same results with any number of them."""

from multilica.workers.pool import Workers
from multilica.workers.processes import available_cores, open_workers
from multilica.workers.shared import Shared

__all__ = ["Shared", "Workers", "available_cores", "open_workers"]
