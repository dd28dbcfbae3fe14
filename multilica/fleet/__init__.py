# SPDX-License-Identifier: Apache-2.0
"""Many logs as one table of extrinsics over time."""
