# SPDX-License-Identifier: Apache-2.0
"""The stages applied to all LiDARs and pairs of a snapshot, on one mutable state."""
