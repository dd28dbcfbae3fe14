# SPDX-License-Identifier: Apache-2.0
"""Worker processes: the same results with any number of them."""

from multilica.workers.pool import Shared, Workers
from multilica.workers.processes import available_cores, open_workers

__all__ = ["Shared", "Workers", "available_cores", "open_workers"]
