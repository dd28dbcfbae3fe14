# SPDX-License-Identifier: Apache-2.0
"""LiDARs that move on their vehicles, found in their poses over time."""
