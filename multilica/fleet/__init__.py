# SPDX-License-Identifier: Apache-2.0
"""Many logs of a fleet as one table of extrinsics over time."""
